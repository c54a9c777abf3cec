// Files that are not recordings: opens the page of each, reads what it shows, and uses its controls. Prints the results as
// JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the server's address, the
// folder for screenshots, and as JSON: the ids of the files by name.
import { readFileSync } from "node:fs";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { launchBrowser } from "./chromium.mjs";
import { isEnvironmentError } from "./console_errors.mjs";

const [web, executablePath, link, address, pictures, input] = process.argv.slice(2);
const ids = JSON.parse(input);
const axe = readFileSync(createRequire(`${web}/package.json`).resolve("axe-core/axe.min.js"), "utf8");
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
const DESKTOP = { width: 1280, height: 900 };
const MAX_TRIES = 4;
const SETTLE_MS = 300;
const PHONE = { width: 360, height: 740 };
const WITH_PICTURES = process.env.KLEINKRAM_TEST_PICTURES === "1";

const browser = await launchBrowser(web, executablePath);
const context = await browser.newContext({ acceptDownloads: true, viewport: DESKTOP, reducedMotion: "reduce" });
await context.grantPermissions(["clipboard-read", "clipboard-write"]);
await context.addInitScript(() => {
  globalThis.violations = [];
  globalThis.longTasks = [];
  document.addEventListener("securitypolicyviolation", ({ violatedDirective, blockedURI }) => globalThis.violations.push(`${violatedDirective} ${blockedURI}`));
  new PerformanceObserver((list) => globalThis.longTasks.push(...list.getEntries().map(({ duration }) => duration))).observe({ type: "longtask" });
});
const page = await context.newPage();
page.setDefaultTimeout(60_000);
const results = { consoleErrors: [], executed: [], cspViolations: [], axe: [], overflowing: [], downloads: [] };
let current = "";
page.on("console", (message) => {
  if (["error", "warning"].includes(message.type()) && !isEnvironmentError(message.text())) results.consoleErrors.push(`${current}: ${message.text()}`);
});
page.on("pageerror", (error) => results.consoleErrors.push(`${current}: ${error.message}`));
page.on("dialog", (dialog) => {
  results.executed.push(`${current}: ${dialog.message()}`);
  void dialog.dismiss();
});
page.on("download", () => results.downloads.push(current));
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const text = page.locator("[data-text]");
const click = (name) => page.getByRole("region", { name: "Preview", exact: true }).getByRole("button", { name, exact: true }).click();
const textContent = () => text.evaluate((element) => element.textContent);
const bytesRead = async () => Number(await page.locator("[data-bytes-read]").getAttribute("data-bytes"));

/** Opens the page of a file, and checks it on the desktop; `ready` is what to wait for. */
async function open(name, ready, query = "") {
  current = name;
  await page.goto(`${address}/files/${ids[name]}${query}`);
  await page.locator(ready).first().waitFor();
  return { viewer: await page.locator("[data-viewer-of]").getAttribute("data-viewer-of"), bytesRead: await bytesRead().catch(() => 0) };
}

function runAxe() {
  return page.evaluate(async (runOnly) => {
    const { violations } = await globalThis.axe.run(document, { runOnly, resultTypes: ["violations"], preload: false });
    return violations.map(({ id, nodes }) => `${id} ${nodes[0]?.html} ${nodes[0]?.failureSummary}`);
  }, RULES);
}

async function check(name) {
  for (const [view, scheme, size] of [["desktop", "light", DESKTOP], ["phone-dark", "dark", PHONE]]) {
    await page.emulateMedia({ colorScheme: scheme });
    await page.setViewportSize(size);
    if (!(await page.evaluate(() => "axe" in globalThis))) await page.evaluate(axe);
    let violations = [];
    for (let tries = 0; tries < MAX_TRIES; tries += 1) {
      await page.waitForTimeout(SETTLE_MS); // the colours of a theme change within this time
      violations = await runAxe();
      if (violations.length === 0) break;
    }
    results.axe.push(...violations.map((violation) => `${name} ${view}: ${violation}`));
    const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    if (over > 0) results.overflowing.push(`${name} ${view}: ${over} px`);
    if (WITH_PICTURES) await page.screenshot({ path: `${pictures}/contents-${name.replaceAll(/[^\w]+/g, "-")}-${view}.png`, fullPage: false });
  }
  await page.emulateMedia({ colorScheme: "light" });
  await page.setViewportSize(DESKTOP);
  const { executed, violations } = await page.evaluate(() => ({ executed: globalThis.executed === true, violations: globalThis.violations }));
  if (executed) results.executed.push(name);
  results.cspViolations.push(...violations.map((violation) => `${name}: ${violation}`));
}

/** Returns the pixel of a picture or video at a place, and its size. */
async function drawn(selector, places) {
  return page.locator(selector).evaluate((element, points) => {
    const [width, height] = [element.naturalWidth ?? element.videoWidth, element.naturalHeight ?? element.videoHeight];
    const canvas = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
    canvas.drawImage(element, 0, 0);
    return { width, height, pixels: points.map(([x, y]) => [...canvas.getImageData(x, y, 1, 1).data.slice(0, 3)]) };
  }, places);
}

async function longText() {
  const shown = { ...(await open("long.log", "[data-text]")), first: await textContent() };
  await click("Load more");
  await page.waitForFunction(() => Number(document.querySelector("[data-until]").dataset.until) > 300_000);
  shown.more = await textContent();
  await page.getByRole("searchbox").fill("POSE 12.25");
  await page.locator("[data-matches]").filter({ hasText: "1 of 1" }).waitFor();
  shown.mark = await page.locator("mark.current").innerText();
  shown.isMarkVisible = await page.locator("mark.current").evaluate((mark) => mark.getBoundingClientRect().top < innerHeight);
  await page.getByRole("searchbox").fill("plausible");
  await page.locator("[data-matches]").filter({ hasText: "1,000 or more" }).waitFor();
  await page.getByRole("searchbox").press("Enter");
  shown.matches = await page.locator("[data-matches]").innerText();
  await page.getByRole("searchbox").fill("");
  await click("End of file");
  await page.waitForFunction(() => Number(document.querySelector("[data-from]").dataset.from) > 1_000_000);
  shown.end = await textContent();
  shown.endBytesRead = await bytesRead();
  for (let steps = 0; steps < 6; steps += 1) {
    const from = await page.locator("[data-from]").getAttribute("data-from");
    await click("Load earlier");
    await page.waitForFunction((before) => document.querySelector("[data-from]").dataset.from !== before, from);
  }
  shown.window = await page.locator("[data-from]").evaluate(({ dataset }) => dataset.until - dataset.from);
  shown.longestTask = Math.max(0, ...(await page.evaluate(() => globalThis.longTasks)));
  await check("long.log");
  return shown;
}

async function json() {
  const shown = { ...(await open("state.json", "[data-text]")), original: await textContent() };
  await click("Format");
  await page.getByRole("button", { name: "Original" }).waitFor();
  shown.formatted = await textContent();
  await click("Copy");
  shown.copied = await page.evaluate(() => navigator.clipboard.readText());
  await check("state.json");
  return shown;
}

async function table() {
  const shown = await open("table.csv", "[data-rows]");
  shown.rowCount = Number(await page.locator("[data-rows]").getAttribute("data-rows"));
  shown.cells = await page.locator("[data-viewer-of] tbody tr").evaluateAll((rows) => rows.map((row) => [...row.children].map(({ textContent: cell }) => cell)));
  await check("table.csv");
  await page.locator("[data-show]").selectOption("curves");
  await page.locator("[data-table-curves] canvas").waitFor();
  await page.locator('[data-field="square"]').uncheck();
  await page.locator('[data-table-curves] [role=img]:not([aria-label*="square"])').waitFor();
  shown.curves = await page.locator("[data-table-curves] [role=img]").getAttribute("aria-label");
  await check("table.csv curves");
  shown.address = page.url();
  await page.reload();
  await page.locator("[data-table-curves] canvas").waitFor();
  shown.curvesAgain = await page.locator("[data-table-curves] [role=img]").getAttribute("aria-label");
  await page.getByLabel("Shown as").selectOption("text");
  await text.waitFor();
  shown.asText = (await textContent()).slice(0, 100);
  return shown;
}

async function trajectory() {
  const shown = await open("real.tum", "[data-table-path] svg");
  shown.points = Number(await page.locator("[data-table-path]").getAttribute("data-points"));
  shown.label = await page.locator("[data-table-path] svg").getAttribute("aria-label");
  shown.extent = await page.locator("[data-table-path] figcaption").innerText();
  await check("real.tum");
  await page.locator("[data-show]").selectOption("curves");
  await page.locator("[data-table-curves] canvas").waitFor();
  shown.curves = await page.locator("[data-table-curves] [role=img]").getAttribute("aria-label");
  return shown;
}

async function flightLog() {
  current = "real.ulg";
  await page.goto(`${address}/files/${ids["real.ulg"]}?topic=vehicle_attitude`);
  await page.locator("[data-plot-viewer][data-messages]").waitFor();
  const shown = { topics: await page.getByLabel("Topic", { exact: true }).locator("option").allInnerTexts(), bytesRead: await bytesRead() };
  await page.getByRole("button", { name: "Show values" }).click();
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Save as CSV" }).click()]);
  shown.csv = await readFile(await download.path(), "utf8");
  await check("real.ulg");
  return shown;
}

async function video() {
  const shown = await open("clip.webm", "video");
  await page.waitForFunction(() => document.querySelector("video").readyState >= 2);
  await page.locator("video").evaluate((element) => new Promise((resolve) => {
    element.addEventListener("seeked", resolve, { once: true });
    element.currentTime = 1.05;
  }));
  shown.duration = await page.locator("video").evaluate(({ duration }) => duration);
  Object.assign(shown, await drawn("video", [[32, 24]]));
  await check("clip.webm");
  return shown;
}

results.long = await longText();
results.json = await json();
results.table = await table();
results.trajectory = await trajectory();
results.flightLog = await flightLog();
results.video = await video();
results.sound = await open("tone.wav", "audio");
await page.waitForFunction(() => document.querySelector("audio").readyState >= 1);
results.sound.duration = await page.locator("audio").evaluate(({ duration }) => duration);
await check("tone.wav");
results.pictures = {};
for (const ending of ["png", "jpg", "webp", "gif", "bmp"]) {
  const shown = await open(`photo.${ending}`, "[data-viewer-of] img");
  await page.waitForFunction(() => document.querySelector("[data-viewer-of] img").complete);
  results.pictures[ending] = { ...shown, ...(await drawn("[data-viewer-of] img", [[10, 70], [110, 10], [60, 40]])) };
}
await check("photo.bmp");
results.texts = {};
for (const name of ["notes.md", "config.yaml", "latin.log", "drawing.svg", "page.html", "page.png", "one-line.txt"]) {
  results.texts[name] = { ...(await open(name, "[data-text]")), text: await textContent(), elements: await text.locator("*:not(.block):not(mark)").count(), status: await page.locator("[data-viewer-of] [role=status]").last().innerText() };
  results.texts[name].longestTask = Math.max(0, ...(await page.evaluate(() => globalThis.longTasks)));
  if (["latin.log", "page.html"].includes(name)) await check(name);
}
results.wide = await open("wide.csv", "[data-rows]");
results.wide.heads = await page.locator("[data-viewer-of] thead th").count();
results.wide.text = await page.locator("[data-viewer-of]").innerText();
await page.locator("[data-show]").selectOption("curves");
await page.locator("[data-table-curves] canvas").waitFor();
results.wide.fields = await page.locator("[data-table-curves] [data-field]").count();
await check("wide.csv");
results.formula = { ...(await open("formula.csv", "[data-rows]")), cell: await page.locator("[data-viewer-of] tbody tr:nth-child(2) td").first().innerText() };
await check("formula.csv");
results.sentences = {};
for (const [name, ready] of [["noise.txt", "[data-bytes-dump]"], ["photo.tiff", "[data-bytes-dump]"], ["bomb.png", "[data-read-failure]"], ["broken.png", "[data-viewer-of] [role=alert]"], ["cut.mp4", "[data-viewer-of] [role=alert]"], ["paper.pdf", "[data-viewer-of=pdf]"]]) {
  const shown = await open(name, ready);
  results.sentences[name] = { ...shown, text: await page.locator("[data-viewer-of]").innerText() };
  await check(name);
}
await browser.close();
process.stdout.write(JSON.stringify(results));
