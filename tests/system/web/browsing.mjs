// Shared by the browser programs: starts a browser, opens pages, and checks what they show. every_page.mjs checks all
// pages as they load; axe runs here on what only clicks open.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { launchBrowser } from "./chromium.mjs";
import { isEnvironmentError } from "./console_errors.mjs";

const TIMEOUT_MS = 60_000;
const MAX_TRIES = 4;
const SCROLLED_PX = 100;
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
const DESKTOP = { width: 1440, height: 900 };
const VIEWS = [["desktop", "light", DESKTOP], ["phone-dark", "dark", { width: 360, height: 780 }]];
const WITH_PICTURES = process.env.KLEINKRAM_TEST_PICTURES === "1";

/** Starts the browser. `web` is the folder with playwright-core and axe-core, `pictures` the folder for screenshots. */
export async function openBrowser(web, executablePath, pictures) {
  const require = createRequire(`${web}/package.json`);
  const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
  const browser = await launchBrowser(web, executablePath);
  const results = { consoleErrors: [], axe: [], overflowing: [], executed: [] };

  /** Opens a page with its own cookies. A request may fail where `expectsErrors`, which gets its address, returns true. `options`: of the context. */
  async function openPage(expectsErrors = () => false, options = {}) {
    const context = await browser.newContext({ viewport: DESKTOP, reducedMotion: "reduce", acceptDownloads: true, ...options });
    const page = await context.newPage();
    page.setDefaultTimeout(TIMEOUT_MS);
    page.on("console", (message) => {
      const { url } = message.location();
      const isExpected = isEnvironmentError(message.text()) || (message.text().startsWith("Failed to load resource") && expectsErrors(url));
      if (["error", "warning"].includes(message.type()) && !isExpected) results.consoleErrors.push(`${message.text()} ${url}`);
    });
    page.on("pageerror", (error) => {
      if (!isEnvironmentError(error.message)) results.consoleErrors.push(error.message);
    });
    page.on("dialog", (dialog) => {
      results.executed.push(dialog.message());
      void dialog.dismiss();
    });
    return { context, page };
  }

  /**
   * Returns the violations that axe reports. Repeats the check, because the layout may still be changing; further down,
   * because a bar at the edge of the window may cover a part of a button.
   */
  async function runAxe(page) {
    let violations = [];
    for (let tries = 0; tries < MAX_TRIES; tries += 1) {
      await page.evaluate((pixels) => window.scrollBy(0, pixels), tries * SCROLLED_PX);
      await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
      violations = await page.evaluate(async (runOnly) => {
        // Without loading stylesheets once more: only a rule that is not among these needs that.
        const result = await globalThis.axe.run(document, { runOnly, resultTypes: ["violations"], preload: false });
        return result.violations.map(({ id, nodes }) => `${id} ${nodes[0]?.html}`);
      }, RULES);
      if (violations.length === 0) break;
    }
    return violations;
  }

  /** Changes theme and size at once: the page takes long to compute a new layout for each. */
  async function setView(page, colorScheme, viewport) {
    await Promise.all([page.emulateMedia({ colorScheme }), page.setViewportSize(viewport)]);
  }

  /** Checks the current state of a page in all views, and takes a screenshot of each, if wanted. */
  async function checkPage(page, name) {
    if (!(await page.evaluate(() => "axe" in globalThis))) await page.evaluate(axe);
    for (const [view, colorScheme, viewport] of VIEWS) {
      await setView(page, colorScheme, viewport);
      await page.waitForFunction((theme) => document.documentElement.dataset.theme === theme, colorScheme);
      results.axe.push(...(await runAxe(page)).map((violation) => `${name} ${view}: ${violation}`));
      if (await page.evaluate(() => document.documentElement.scrollWidth > document.documentElement.clientWidth)) results.overflowing.push(`${name} ${view}`);
      if (WITH_PICTURES) await page.screenshot({ path: `${pictures}/${name}-${view}.png` });
    }
    await setView(page, "light", DESKTOP);
  }

  /** Closes the browser, and prints the results as JSON. */
  async function printResults() {
    await browser.close();
    process.stdout.write(JSON.stringify(results));
  }

  return { results, openPage, checkPage, printResults };
}
