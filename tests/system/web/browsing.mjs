// What the programs that click have in common: a browser, people in it, and a look at what they have before them.
// How every page looks is told by every_page.mjs; here axe looks at what only clicking opens.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { isOfTheMachine } from "./complaints.mjs";

const PATIENCE_MS = 60_000;
const MOST_TRIES = 4;
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
const WIDE = { width: 1440, height: 900 };
const LOOKS = [["desktop", "light", WIDE], ["phone-dark", "dark", { width: 360, height: 780 }]];

/** Starts the browser. `web` is the folder with playwright-core and axe-core, `pictures` where pictures go. */
export async function openBrowser(web, executablePath, pictures) {
  const require = createRequire(`${web}/package.json`);
  const { chromium } = require("playwright-core");
  const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
  const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
  const results = { complaints: [], axe: [], wide: [], ran: [] };

  /** Somebody with a browser of their own. The server may refuse what they ask where `mayBeRefused` says so. */
  async function somebody(mayBeRefused = () => false) {
    const context = await browser.newContext({ viewport: WIDE, reducedMotion: "reduce", acceptDownloads: true });
    const page = await context.newPage();
    page.setDefaultTimeout(PATIENCE_MS);
    page.on("console", (message) => {
      const isMeant = isOfTheMachine(message.text()) || (message.text().startsWith("Failed to load resource") && mayBeRefused());
      if (["error", "warning"].includes(message.type()) && !isMeant) results.complaints.push(`${message.text()} ${message.location().url}`);
    });
    page.on("pageerror", (error) => {
      if (!isOfTheMachine(error.message)) results.complaints.push(error.message);
    });
    page.on("dialog", (dialog) => {
      results.ran.push(dialog.message());
      void dialog.dismiss();
    });
    return { context, page };
  }

  /** What axe finds once colours and columns have settled: a page that is still being laid out anew is asked again. */
  async function settledAxe(page) {
    let found = [];
    for (let tries = 0; tries < MOST_TRIES; tries += 1) {
      await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
      found = await page.evaluate(async (runOnly) => {
        const { violations } = await globalThis.axe.run(document, { runOnly, resultTypes: ["violations"] });
        return violations.map(({ id, nodes }) => `${id} ${nodes[0]?.html}`);
      }, RULES);
      if (found.length === 0) break;
    }
    return found;
  }

  /** Looks at what somebody has before them, wide and light, narrow and dark. */
  async function checkPage(page, name) {
    await page.evaluate(axe);
    for (const [kind, colorScheme, viewport] of LOOKS) {
      await page.emulateMedia({ colorScheme });
      await page.setViewportSize(viewport);
      await page.waitForFunction((theme) => document.documentElement.dataset.theme === theme, colorScheme);
      results.axe.push(...(await settledAxe(page)).map((found) => `${name} ${kind}: ${found}`));
      if (await page.evaluate(() => document.documentElement.scrollWidth > document.documentElement.clientWidth)) results.wide.push(`${name} ${kind}`);
      await page.screenshot({ path: `${pictures}/${name}-${kind}.png` });
    }
    await page.emulateMedia({ colorScheme: "light" });
    await page.setViewportSize(WIDE);
  }

  /** Ends the browser, and prints as JSON what was seen. */
  async function printResults() {
    await browser.close();
    process.stdout.write(JSON.stringify(results));
  }

  return { results, somebody, checkPage, printResults };
}
