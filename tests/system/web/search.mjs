// What a person does who looks for recordings: from home to the box by a key, terms by typing and by clicking, what
// cannot be read, into a file and back, labels, a script that downloads. Prints as JSON what was seen.
// Arguments: the folder with playwright-core and axe-core, the browser, a link that signs in, the server's address, where
// pictures go.
import { readFile } from "node:fs/promises";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [web, executablePath, link, address, pictures] = process.argv.slice(2);
const require = createRequire(`${web}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const PATIENCE_MS = 60_000;

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, acceptDownloads: true });
const page = await context.newPage();
page.setDefaultTimeout(PATIENCE_MS);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const seen = { complaints: [], axe: [], wide: {} };
let isMeantToFail = false;
page.on("console", (message) => {
  if (["error", "warning"].includes(message.type()) && !isMeantToFail) seen.complaints.push(message.text());
});
page.on("pageerror", (error) => seen.complaints.push(error.message));

const LOOKS = { light: [1440, "light"], dark: [1440, "dark"], phone: [360, "light"], "phone-dark": [360, "dark"] };

async function check(name, where = page) {
  await where.evaluate(axe);
  const found = await where.evaluate(() => globalThis.axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"] }));
  seen.axe.push(...found.violations.map(({ id, nodes }) => `${name}: ${id} ${nodes[0]?.html}`));
}

/** A page as it looks in light and dark, wide and on a phone; axe looks at each. */
async function look(name, where = page) {
  for (const [how, [width, colorScheme]] of Object.entries(LOOKS)) {
    await where.setViewportSize({ width, height: width === 360 ? 780 : 900 });
    await where.emulateMedia({ colorScheme });
    await check(`${name} ${how}`, where);
    seen.wide[`${name} ${how}`] = await where.evaluate(() => document.documentElement.scrollWidth - globalThis.innerWidth);
    await where.screenshot({ path: `${pictures}/${name}-${how}.png` });
  }
  await where.setViewportSize({ width: 1440, height: 900 });
  await where.emulateMedia({ colorScheme: "light" });
}

const box = page.getByRole("textbox", { name: "Search files, missions and topics" });
const query = () => page.locator("[data-found]").getAttribute("data-query");
const tabs = () => page.locator("[data-found] nav a").allInnerTexts();
const rows = () => page.locator("[data-found] [data-way]").allInnerTexts();
const asked = () => new URL(page.url()).searchParams.get("q");

async function searched(wanted) {
  await page.waitForFunction((text) => document.querySelector("[data-found]")?.getAttribute("data-query") === text, wanted);
  await page.waitForFunction(() => document.querySelector("[data-found] [aria-busy]") === null);
}

await page.locator("[data-recent] [data-way]").first().waitFor();
await page.locator("[data-attention] li").first().waitFor();
seen.home = await page.locator("main").innerText();
await look("home");

await page.keyboard.press("/"); // no box here: to the search
await page.waitForURL((url) => url.pathname === "/search");
await searched("");
seen.all = await tabs();
await page.keyboard.press("/");
await page.keyboard.type("alps topic:/imu/* format:mcap");
await searched("alps topic:/imu/* format:mcap");
seen.typed = { asked: asked(), tabs: await tabs(), rows: await rows(), command: await page.locator("[data-command] pre").innerText() };
await look("search");

await box.press("ArrowDown");
await page.waitForFunction(() => document.activeElement?.hasAttribute("data-way"));
await page.keyboard.press("ArrowDown");
await page.waitForFunction(() => document.activeElement?.closest("[data-index]")?.getAttribute("data-index") === "1");
const second = (await rows())[1].split("\n")[0];
await page.keyboard.press("Enter");
await page.waitForURL((url) => url.pathname.startsWith("/files/"));
await page.getByRole("heading", { level: 1 }).filter({ hasText: second }).waitFor();
await page.goBack();
await searched("alps topic:/imu/* format:mcap");
seen.back = { asked: asked(), box: await box.inputValue() };

await page.getByRole("region", { name: "Month" }).getByRole("link").first().click();
await page.waitForFunction(() => document.querySelector("[data-found]")?.getAttribute("data-query").includes("month:"));
seen.faceted = { query: await query(), box: await box.inputValue() };
await page.getByRole("region", { name: "Month" }).getByRole("link", { name: /^chosen/ }).click();
await searched("alps topic:/imu/* format:mcap");

isMeantToFail = true;
await box.fill("alps size:big");
await box.press("Enter");
await page.locator("[data-wrong]").waitFor();
seen.wrong = { told: await page.locator("[data-wrong]").innerText(), mark: await page.locator("[data-wrong] mark").innerText(), rows: (await rows()).length };
await check("wrong");
isMeantToFail = false;

await box.fill('mission:"Wet *"');
await box.press("Enter");
await searched('mission:"Wet *"');
await page.getByRole("link", { name: /^Missions/ }).click();
await page.waitForURL((url) => url.searchParams.get("tab") === "missions");
await page.locator("[data-found] [data-way]").first().waitFor();
seen.markup = { rows: await rows(), elements: await page.locator("[data-found] img, [data-found] b").count() };
await page.getByRole("link", { name: /^Topics/ }).click();
await page.waitForURL((url) => url.searchParams.get("tab") === "topics");
await page.getByRole("link", { name: "/imu/data" }).first().waitFor();
await page.locator("[data-found] [data-way]", { hasText: "/imu/data" }).click();
await page.waitForURL((url) => url.searchParams.get("tab") === "files");
await page.waitForFunction(() => document.querySelector("[data-found]")?.getAttribute("data-query").includes("topic:/imu/data"));
seen.topic = await query();

await box.fill("alps format:mcap");
await box.press("Enter");
await searched("alps format:mcap");
await page.getByRole("checkbox", { name: "Select all" }).click();
await page.getByRole("button", { name: "Label" }).click();
await page.getByRole("textbox", { name: "Add" }).fill("paper, icra 27");
await check("labels");
await page.getByRole("button", { name: "Change labels" }).click();
await page.getByText("were changed").waitFor();
await page.getByRole("dialog").waitFor({ state: "detached" });
await page.getByRole("button", { name: "Clear selection" }).click();

await page.getByRole("button", { name: "Download" }).click();
const dialog = page.getByRole("dialog", { name: "Download what was found" });
await dialog.locator("strong").waitFor();
seen.amount = await dialog.locator("strong").innerText();
await check("download");
const [script] = await Promise.all([page.waitForEvent("download"), dialog.getByRole("button", { name: "Save as a script" }).click()]);
seen.script = await readFile(await script.path(), "utf8");

// Somebody without an account sees what is public, and nothing else.
const stranger = await (await browser.newContext({ viewport: { width: 1440, height: 900 } })).newPage();
stranger.setDefaultTimeout(PATIENCE_MS);
await stranger.goto(`${address}/public`);
await stranger.getByRole("link", { name: "Lakes" }).waitFor();
seen.public = await stranger.locator("[data-way]").allInnerTexts();
await look("public", stranger);
await stranger.getByRole("link", { name: "Search in them" }).click();
await stranger.locator("[data-found] [data-way]").first().waitFor();
seen.publicRows = await stranger.locator("[data-found] [data-way]").allInnerTexts();
seen.publicBoxes = await stranger.getByRole("checkbox").count();

await browser.close();
process.stdout.write(JSON.stringify(seen));
