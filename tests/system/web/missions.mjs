// What people do with missions: say metadata that is refused and then accepted, scroll ten thousand files, give a right
// to somebody who looks on in another browser and take it away, and meet names that are full of markup.
// Prints as JSON what was seen. Arguments: the folder with playwright-core and axe-core, the browser, a link that signs
// in, the server's address, an invitation for somebody else, their name, ids of project, mission, and the large mission,
// where pictures go.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [web, executablePath, link, address, invitation, guest, project, mission, large, pictures] = process.argv.slice(2);
const require = createRequire(`${web}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const PATIENCE_MS = 60_000;

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const seen = { complaints: [], axe: [], dialogs: 0, wide: [] };

async function person(at) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, bypassCSP: false });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  page.on("dialog", (dialog) => {
    seen.dialogs += 1;
    void dialog.dismiss();
  });
  page.on("pageerror", (error) => seen.complaints.push(error.message));
  page.on("console", (message) => {
    if (/Content Security Policy/i.test(message.text())) seen.complaints.push(message.text());
  });
  await page.goto(at);
  return page;
}

const page = await person(link);
await page.waitForURL((url) => url.pathname === "/");

async function look(name) {
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"] }));
  seen.axe.push(...found.violations.map(({ id, nodes }) => `${name}: ${id} ${nodes[0]?.html}`));
  for (const [kind, colorScheme, width] of [["light", "light", 1440], ["dark", "dark", 1440], ["phone", "light", 360], ["phone-dark", "dark", 360]]) {
    await page.emulateMedia({ colorScheme });
    await page.setViewportSize({ width, height: width === 360 ? 780 : 900 });
    const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    if (over > 0) seen.wide.push(`${name} ${kind}: ${over}`);
    await page.screenshot({ path: `${pictures}/mission-${name}-${kind}.png` });
  }
  await page.emulateMedia({ colorScheme: "light" });
  await page.setViewportSize({ width: 1440, height: 900 });
}

// Metadata, refused by the server's own rule and then accepted; markup in it is text.
await page.goto(`${address}/missions/${mission}`);
await page.locator("[data-lanes]").waitFor();
seen.title = await page.locator("h1").innerText();
await look("files");
const metadata = page.locator("[data-metadata]");
await metadata.getByRole("button", { name: "ada" }).click();
await metadata.getByLabel("operator").fill("ADA 1");
await metadata.getByRole("button", { name: "Save" }).click();
await metadata.getByText("must match").first().waitFor();
seen.refused = await metadata.innerText();
await metadata.getByLabel("operator").fill("grace");
await metadata.getByRole("button", { name: "Save" }).click();
await metadata.getByRole("button", { name: "grace" }).waitFor();
seen.accepted = await metadata.innerText();
const notes = page.locator("[data-notes]");
await notes.getByRole("button").click();
await notes.getByRole("textbox").fill("<img src=x onerror=alert(1)> **kept**");
await notes.getByRole("button", { name: "Save" }).click();
await notes.getByText("<img src=x onerror=alert(1)> **kept**").waitFor();

// Topics and what is odd.
await page.goto(`${address}/missions/${mission}?tab=topics`);
await page.getByRole("table").locator("svg[role=img]").first().waitFor();
seen.topics = await page.getByRole("table").innerText();
await look("topics");

// Ten thousand files.
await page.goto(`${address}/missions/${large}`);
await page.getByRole("button", { name: "Open all folders" }).click();
await page.locator("[role=table][aria-rowcount]").waitFor();
seen.rows = Number(await page.getByRole("table").getAttribute("aria-rowcount"));
seen.drawn = await page.getByRole("row").count();
await page.evaluate(() => {
  globalThis.longest = 0;
  new PerformanceObserver((list) => list.getEntries().forEach((each) => (globalThis.longest = Math.max(globalThis.longest, each.duration)))).observe({ type: "longtask" });
});
for (let at = 0; at < 40; at += 1) await page.mouse.wheel(0, 700);
await page.evaluate(() => window.scrollTo(0, document.documentElement.scrollHeight));
await page.getByText("frame_9999.txt").waitFor();
seen.longestTask = await page.evaluate(() => globalThis.longest);
seen.drawnAtEnd = await page.getByRole("row").count();

// Somebody else looks on while a right is given and taken away.
const other = await person(invitation);
await other.getByLabel(/password/i).fill("a long enough password");
await other.getByRole("button", { name: "Make my account" }).click();
await other.waitForURL((url) => url.pathname === "/");
await other.goto(`${address}/missions/${mission}`);
seen.before = await other.getByRole("alert").first().innerText();
await page.goto(`${address}/projects/${project}?tab=access`);
const form = page.locator("[data-grant-form]");
await form.getByLabel("Person, group or e-mail address").fill(guest);
await form.getByRole("button", { name: guest }).first().click();
await form.getByRole("button", { name: "Give" }).click();
await page.locator(`[data-grant="${guest}"]`).waitFor();
await look("access");
await other.goto(`${address}/missions/${mission}`);
await other.locator("[data-lanes]").waitFor();
seen.granted = await other.locator("h1").innerText();
await page.getByRole("button", { name: `Take the right away from ${guest}` }).click();
await page.getByRole("button", { name: "Take away" }).click();
await page.locator(`[data-grant="${guest}"]`).waitFor({ state: "detached" });
await other.getByRole("alert").first().waitFor(); // by itself: what changed is told
seen.revoked = await other.getByRole("alert").first().innerText();

// The project's other pages, with markup in all that people name.
for (const tab of ["missions", "stats", "fields", "activity", "settings"]) {
  await page.goto(`${address}/projects/${project}?tab=${tab}`);
  await page.locator("h1").getByText("<b>").waitFor();
  await page.getByRole("navigation", { name: "Views of the project" }).locator("[aria-current=page]").waitFor();
  await look(`project-${tab}`);
}
seen.elements = await page.evaluate(() => document.querySelectorAll("main img, main script, main b").length);
await browser.close();
process.stdout.write(JSON.stringify(seen));
