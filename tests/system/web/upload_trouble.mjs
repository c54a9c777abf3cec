// Faults during an upload: the API is killed, the session ends, two tabs upload into one mission, a file changes, and the
// upload is cancelled. Prints the results as JSON. Arguments: the folder with playwright-core, the browser, a sign-in
// link, the server's address, the folder to upload, a file to change, the folder for screenshots, the process id of the
// API.
import { appendFile } from "node:fs/promises";
import { launchBrowser } from "./chromium.mjs";

const [web, executablePath, link, address, folder, changing, pictures, api] = process.argv.slice(2);
const TIMEOUT_MS = 60_000;
const WITH_PICTURES = process.env.KLEINKRAM_TEST_PICTURES === "1";
// However slow this machine is, an upload at this rate is not over before the next step. The parts of a large file may
// all be signed when it begins, so that only its end needs the API; many small files need it for each of them.
const SLOW = 1e6;

const browser = await launchBrowser(web, executablePath);
const context = await browser.newContext({ viewport: { width: 1280, height: 900 } });
const page = await context.newPage();
page.setDefaultTimeout(TIMEOUT_MS);
const results = { errors: [] };
page.on("pageerror", (error) => results.errors.push(error.message));
page.on("dialog", (dialog) => void dialog.accept());
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const panel = page.locator("[data-phase]").first();

const networkSession = await context.newCDPSession(page);
await networkSession.send("Network.enable");
async function limitUploadRate(bytesPerSecond) {
  const conditions = { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: bytesPerSecond };
  await networkSession.send("Network.emulateNetworkConditions", conditions);
}

async function choose(target, path, button) {
  const [chooser] = await Promise.all([target.waitForEvent("filechooser"), target.getByRole("button", { name: button }).last().click()]);
  await chooser.setFiles(path);
}

async function begin(target) {
  await target.getByRole("button", { name: /^Upload \d+ file/ }).click();
}

async function currentProgress() {
  return Number(await panel.getByRole("progressbar").first().getAttribute("aria-valuenow"));
}

async function waitForProgress(percent) {
  await page.waitForFunction(
    (least) => Number(document.querySelector("[data-phase] [role=progressbar]")?.getAttribute("aria-valuenow")) >= least,
    percent,
  );
}

// Uploads into a new mission; the API is killed, and its supervisor restarts it.
await page.goto(`${address}/upload`);
await choose(page, folder, "Choose a folder");
await page.getByLabel("Project").selectOption({ label: "Alps" });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel("Mission name").fill("descent");
await limitUploadRate(SLOW);
await begin(page);
await waitForProgress(1);
process.kill(Number(api), "SIGKILL");
const unreachable = panel.getByText("The server does not respond");
await unreachable.waitFor();
results.unreachable = await panel.innerText();
await unreachable.waitFor({ state: "hidden" });
results.reachable = await panel.getAttribute("data-phase");

// The session ends. After the person signs in again in another window, the upload continues.
const session = await context.cookies();
await context.clearCookies();
await page.locator("[data-phase=signed_out]").waitFor(); // the page may notice the end of the session before the upload does
await page.getByRole("dialog").getByRole("button", { name: "Sign in" }).waitFor();
results.signedOut = await panel.innerText();
if (WITH_PICTURES) await page.screenshot({ path: `${pictures}/upload-signed-out.png` });
const progressSignedOut = await currentProgress();
await context.addCookies(session);
await page.evaluate(() => globalThis.dispatchEvent(new Event("focus")));
await page.locator("[data-phase=running]").waitFor();
await waitForProgress(progressSignedOut + 1);

// A second tab uploads into the same mission, while the first upload is still in progress.
const mission = (await panel.getByRole("link", { name: "descent" }).getAttribute("href")).split("/").at(-1);
const otherTab = await context.newPage();
otherTab.setDefaultTimeout(TIMEOUT_MS);
await otherTab.goto(`${address}/upload?mission=${mission}`);
await otherTab.locator("[data-unfinished]").waitFor();
results.unfinishedInOtherTab = await otherTab.locator("[data-unfinished]").innerText();
await choose(otherTab, changing, "Choose files");
await begin(otherTab);
await otherTab.locator("[data-phase=elsewhere]").waitFor();
results.refusedInOtherTab = await otherTab.locator("[data-phase]").innerText();
await otherTab.close();
await limitUploadRate(-1);
await page.locator("[data-phase=over]").waitFor();
results.finished = await panel.innerText();

// A file changes during its upload.
await page.goto(`${address}/upload?mission=${mission}`);
await limitUploadRate(SLOW);
await choose(page, changing, "Choose files");
await begin(page);
await waitForProgress(1);
await appendFile(changing, "one more message");
await page.locator("[data-phase=over]").waitFor();
results.changed = await panel.innerText();

// The file is chosen again, and the upload is cancelled.
await panel.getByRole("button", { name: "Close" }).click();
await choose(page, changing, "Choose files");
await begin(page);
await waitForProgress(1);
await panel.getByRole("button", { name: "Cancel" }).click();
await page.getByRole("button", { name: "Cancel upload" }).click();
await page.locator("[data-phase=cancelled]").waitFor();
results.cancelled = await panel.getByRole("status").first().innerText();
await page.goto(`${address}/upload`);
await page.getByRole("button", { name: "Choose files" }).waitFor();
results.unfinishedAfterCancel = await page.locator("[data-unfinished]").count();
await browser.close();
process.stdout.write(JSON.stringify(results));
