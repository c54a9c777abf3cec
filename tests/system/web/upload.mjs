// What a person does who uploads from a browser: drops a folder, is told what is missing, loses the network, looks at
// another page, pauses, reloads, chooses the folder again; then meets what is there already, and a file that changes.
// Prints as JSON what was seen. Arguments: the folder with playwright-core and axe-core, the browser, a link that signs
// in, the server's address, the folder to upload, a folder of the same names with other content, where pictures go.
import { appendFile } from "node:fs/promises";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { isOfTheMachine } from "./complaints.mjs";

const [web, executablePath, link, address, folder, other, pictures] = process.argv.slice(2);
const require = createRequire(`${web}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const PATIENCE_MS = 60_000;

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 1280, height: 900 } });
const page = await context.newPage();
page.setDefaultTimeout(PATIENCE_MS);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const results = { complaints: [], axe: [], dialogs: [] };
let isMeantToFail = false;
page.on("console", (message) => {
  if (["error", "warning"].includes(message.type()) && !isMeantToFail && !isOfTheMachine(message.text())) results.complaints.push(message.text());
});
page.on("pageerror", (error) => results.complaints.push(error.message));
page.on("dialog", (dialog) => {
  results.dialogs.push(dialog.type());
  void dialog.accept();
});
let puts = 0;
page.on("response", (answer) => {
  if (answer.request().method() === "PUT" && answer.ok()) puts += 1;
});

/** The network: lets so many bytes a second through, all that come without a number, or nothing at all. */
const cable = await context.newCDPSession(page);
async function network(bytesPerSecond, offline = false) {
  await cable.send("Network.enable");
  const at = { offline, latency: 0, downloadThroughput: -1, uploadThroughput: bytesPerSecond ?? -1 };
  await cable.send("Network.emulateNetworkConditions", at);
}
const SLOW = 16e6;

const panel = page.locator("[data-phase]").first();

async function checkPage(name) {
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"] }));
  results.axe.push(...found.violations.map(({ id, nodes }) => `${name}: ${id} ${nodes[0]?.html}`));
  await page.screenshot({ path: `${pictures}/upload-${name}.png`, fullPage: true });
}

async function choose(where, path, button = "Choose a folder") {
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), where.getByRole("button", { name: button }).click()]);
  await chooser.setFiles(path);
}

async function drop(path) {
  const box = await page.locator(".zone").last().boundingBox();
  const at = { x: box.x + box.width / 2, y: box.y + box.height / 2 };
  const data = { items: [], files: [path], dragOperationsMask: 1 };
  const session = await context.newCDPSession(page);
  for (const type of ["dragEnter", "dragOver", "drop"]) await session.send("Input.dispatchDragEvent", { type, ...at, data });
  await session.detach();
}

async function reaches(percent) {
  await page.waitForFunction(
    (least) => Number(document.querySelector("[data-phase] [role=progressbar]")?.getAttribute("aria-valuenow")) >= least,
    percent,
  );
}

async function over() {
  await page.locator("[data-phase=over]").first().waitFor().catch(async (error) => {
    throw new Error(await page.locator("main").innerText(), { cause: error });
  });
  return panel.innerText();
}

// The empty page, then a folder dropped while one of its files is being written to.
await page.goto(`${address}/upload`);
await page.getByRole("button", { name: "Choose a folder" }).waitFor();
await checkPage("empty");
const writing = setInterval(() => void appendFile(`${folder}/growing.bag`, "more of it"), 20);
await drop(folder);
await page.getByText("Files to upload").waitFor();
clearInterval(writing);
results.plan = await page.locator("[aria-label='Files to upload']").innerText();

// Metadata that is not said is asked for; then it is said.
await page.getByLabel("Project").selectOption({ label: "Alps" });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel("robot").waitFor();
await page.getByRole("button", { name: /^Upload \d+ files/ }).click();
results.asked = await page.locator("form").innerText();
await checkPage("form");
await page.getByLabel("Mission name").fill("ascent");
await page.getByLabel("robot").selectOption("spot");
await page.getByLabel("operator").fill("ada.lovelace");
isMeantToFail = true;
await page.getByRole("button", { name: /^Upload \d+ files/ }).click();
await page.getByRole("alert").waitFor();
results.refused = await page.locator("form").innerText();
await page.getByLabel("operator").fill("ada");
await network(SLOW);
await page.getByRole("button", { name: /^Upload \d+ files/ }).click();

// The network goes, and comes back; other pages are looked at; it is paused, and goes on.
await reaches(5);
await network(SLOW, true);
await panel.getByText("continues automatically").first().waitFor();
results.offline = await panel.innerText();
await checkPage("offline");
await network(SLOW);
await reaches(20);
isMeantToFail = false;
await page.getByRole("link", { name: "Projects" }).first().click();
await page.getByRole("link", { name: /^Uploading, / }).click();
await panel.getByRole("button", { name: "Pause" }).click();
await panel.getByText("paused").waitFor();
await checkPage("paused");
await panel.getByRole("button", { name: "Continue" }).click();
await reaches(70); // four parts are on their way at once: six are there for certain

// The page is loaded anew in the middle.
results.putsBefore = puts;
await page.reload();
await page.locator("[data-unfinished]").waitFor();
results.unfinished = await page.locator("[data-unfinished]").innerText();
await checkPage("unfinished");
puts = 0;
await network();
await choose(page.locator("[data-unfinished]"), folder);
await page.getByRole("button", { name: "Resume" }).waitFor();
results.fit = await page.locator("[data-unfinished]").innerText();
await page.getByRole("button", { name: "Resume" }).click();
results.over = await over();
results.putsAfter = puts;
await checkPage("over");
results.mission = (await panel.getByRole("link", { name: "ascent" }).getAttribute("href")).split("/").at(-1);

// The same folder again sends nothing; other content under the same names is refused, with both hashes.
puts = 0;
await page.goto(`${address}/upload?mission=${results.mission}`);
await choose(page, folder);
await page.getByRole("button", { name: /^Upload \d+ files/ }).click();
results.again = await over();
results.putsAgain = puts;
await page.reload();
await choose(page, other);
await page.getByRole("button", { name: /^Upload \d+ file/ }).click();
results.conflict = await over();
await checkPage("conflict");

// Dark, and on a phone.
for (const [name, colorScheme, width] of [["dark", "dark", 1280], ["phone", "light", 360], ["phone-dark", "dark", 360]]) {
  await page.emulateMedia({ colorScheme });
  await page.setViewportSize({ width, height: 780 });
  await page.reload();
  await page.getByRole("button", { name: "Choose files" }).waitFor();
  await choose(page, other);
  await page.getByText("Destination").waitFor();
  results[`${name}Wide`] = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  await checkPage(name);
}
await page.emulateMedia({ colorScheme: "light" });
await page.setViewportSize({ width: 360, height: 780 });
await page.getByRole("button", { name: /^Upload \d+ file/ }).click();
await over();
await checkPage("phone-conflict");
await browser.close();
process.stdout.write(JSON.stringify(results));
