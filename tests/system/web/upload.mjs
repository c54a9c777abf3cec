// An upload with interruptions: drops a folder, corrects its metadata, loses the network, opens another page, pauses,
// reloads, resumes by choosing the folder again; then uploads the same files again, and other files of the same names.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the
// server's address, the folder to upload, a folder of the same names with other content, the folder for screenshots.
import { appendFile } from "node:fs/promises";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { launchBrowser } from "./chromium.mjs";
import { isEnvironmentError } from "./console_errors.mjs";

const [web, executablePath, link, address, folder, other, pictures] = process.argv.slice(2);
const require = createRequire(`${web}/package.json`);
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const TIMEOUT_MS = 60_000;
const WITH_PICTURES = process.env.KLEINKRAM_TEST_PICTURES === "1";

const browser = await launchBrowser(web, executablePath);
const context = await browser.newContext({ viewport: { width: 1280, height: 900 } });
const page = await context.newPage();
page.setDefaultTimeout(TIMEOUT_MS);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const results = { consoleErrors: [], axe: [], dialogs: [] };
let expectsErrors = false;
page.on("console", (message) => {
  if (["error", "warning"].includes(message.type()) && !expectsErrors && !isEnvironmentError(message.text())) results.consoleErrors.push(message.text());
});
page.on("pageerror", (error) => results.consoleErrors.push(error.message));
page.on("dialog", (dialog) => {
  results.dialogs.push(dialog.type());
  void dialog.accept();
});
let puts = 0;
page.on("response", (response) => {
  if (response.request().method() === "PUT" && response.ok()) puts += 1;
});

/** Limits uploads to this rate; without one, the rate is unlimited. With `offline`, all requests fail. */
const networkSession = await context.newCDPSession(page);
async function limitNetwork(bytesPerSecond, offline = false) {
  await networkSession.send("Network.enable");
  const conditions = { offline, latency: 0, downloadThroughput: -1, uploadThroughput: bytesPerSecond ?? -1 };
  await networkSession.send("Network.emulateNetworkConditions", conditions);
}
const SLOW = 16e6;
const VERY_SLOW = 1e6; // however slow this machine is, the upload is not over before the next step

const panel = page.locator("[data-phase]").first();

async function checkPage(name) {
  await page.evaluate(axe);
  const report = await page.evaluate(() => globalThis.axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"], preload: false }));
  results.axe.push(...report.violations.map(({ id, nodes }) => `${name}: ${id} ${nodes[0]?.html}`));
  if (WITH_PICTURES) await page.screenshot({ path: `${pictures}/upload-${name}.png`, fullPage: true });
}

async function choose(where, path, button = "Choose a folder") {
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), where.getByRole("button", { name: button }).click()]);
  await chooser.setFiles(path);
}

async function drop(path) {
  const box = await page.locator(".zone").last().boundingBox();
  const point = { x: box.x + box.width / 2, y: box.y + box.height / 2 };
  const data = { items: [], files: [path], dragOperationsMask: 1 };
  const session = await context.newCDPSession(page);
  for (const type of ["dragEnter", "dragOver", "drop"]) await session.send("Input.dispatchDragEvent", { type, ...point, data });
  await session.detach();
}

async function waitForProgress(percent) {
  await page.waitForFunction(
    (least) => Number(document.querySelector("[data-phase] [role=progressbar]")?.getAttribute("aria-valuenow")) >= least,
    percent,
  );
}

// The mission of the address is chosen once the lists have arrived.
async function uploadChosen(mission) {
  await page.waitForFunction((id) => [...document.querySelectorAll("select")].some((choice) => choice.value === id), mission);
  await page.getByRole("button", { name: /^Upload \d+ files?/ }).click();
}

async function waitForEnd() {
  await page.locator("[data-phase=over]").first().waitFor().catch(async (error) => {
    throw new Error(await page.locator("main").innerText(), { cause: error });
  });
  return panel.innerText();
}

// The empty page; then a folder is dropped while a program writes to one of its files.
await page.goto(`${address}/upload`);
await page.getByRole("button", { name: "Choose a folder" }).waitFor();
await checkPage("empty");
const writing = setInterval(() => void appendFile(`${folder}/growing.bag`, "more of it"), 20);
await drop(folder);
await page.getByText("Files to upload").waitFor();
clearInterval(writing);
results.plan = await page.locator("[aria-label='Files to upload']").innerText();

// Missing and invalid metadata are reported in the form, then corrected.
await page.getByLabel("Project").selectOption({ label: "Alps" });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel("robot").waitFor();
await page.getByRole("button", { name: /^Upload \d+ files/ }).click();
results.missingMetadata = await page.locator("form").innerText();
await checkPage("form");
await page.getByLabel("Mission name").fill("ascent");
await page.getByLabel("robot").selectOption("spot");
await page.getByLabel("operator").fill("ada.lovelace");
expectsErrors = true;
await page.getByRole("button", { name: /^Upload \d+ files/ }).click();
await page.getByRole("alert").waitFor();
results.refused = await page.locator("form").innerText();
await page.getByLabel("operator").fill("ada");
await limitNetwork(SLOW);
await page.getByRole("button", { name: /^Upload \d+ files/ }).click();

// The network fails and recovers; another page is opened; the upload is paused and continued.
await waitForProgress(5);
await limitNetwork(SLOW, true);
await panel.getByText("continues automatically").first().waitFor();
results.offline = await panel.innerText();
await checkPage("offline");
await limitNetwork(SLOW);
await waitForProgress(20);
await limitNetwork(VERY_SLOW);
expectsErrors = false;
await page.getByRole("link", { name: "Projects" }).first().click();
await page.getByRole("link", { name: /^Uploading, / }).click();
await panel.getByRole("button", { name: "Pause" }).click();
await panel.getByText("paused").waitFor();
await checkPage("paused");
await panel.getByRole("button", { name: "Continue" }).click();
await limitNetwork(SLOW);
await waitForProgress(70); // at most four parts are in progress, so six have arrived
await limitNetwork(VERY_SLOW);

// The page is reloaded during the upload.
results.putsBefore = puts;
await page.reload();
await page.locator("[data-unfinished]").waitFor();
results.unfinished = await page.locator("[data-unfinished]").innerText();
await checkPage("unfinished");
puts = 0;
await limitNetwork();
await choose(page.locator("[data-unfinished]"), folder);
await page.getByRole("button", { name: "Resume" }).waitFor();
results.matchingFiles = await page.locator("[data-unfinished]").innerText();
await page.getByRole("button", { name: "Resume" }).click();
results.finished = await waitForEnd();
results.putsAfter = puts;
await checkPage("over");
results.mission = (await panel.getByRole("link", { name: "ascent" }).getAttribute("href")).split("/").at(-1);

// The same folder again sends nothing; other content under the same names is refused, with both hashes.
puts = 0;
await page.goto(`${address}/upload?mission=${results.mission}`);
await choose(page, folder);
await uploadChosen(results.mission);
results.secondUpload = await waitForEnd();
results.putsOfSecondUpload = puts;
await page.reload();
await choose(page, other);
await uploadChosen(results.mission);
results.conflict = await waitForEnd();
await checkPage("conflict");

// Dark theme and phone.
for (const [name, colorScheme, width] of [["dark", "dark", 1280], ["phone", "light", 360], ["phone-dark", "dark", 360]]) {
  await page.emulateMedia({ colorScheme });
  await page.setViewportSize({ width, height: 780 });
  await page.reload();
  await page.getByRole("button", { name: "Choose files" }).waitFor();
  await choose(page, other);
  await page.getByText("Destination").waitFor();
  results[`${name}Overflow`] = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  await checkPage(name);
}
await page.emulateMedia({ colorScheme: "light" });
await page.setViewportSize({ width: 360, height: 780 });
await page.getByRole("button", { name: /^Upload \d+ file/ }).click();
await waitForEnd();
await checkPage("phone-conflict");
await browser.close();
process.stdout.write(JSON.stringify(results));
