// What a person meets who uploads while things go wrong: the server dies, the session ends, a file is written to, two
// tabs upload into one mission, and the upload is given up. Prints as JSON what was seen. Arguments: the folder with
// playwright-core, the browser, a link that signs in, the server's address, the folder to upload, a file to write to,
// where pictures go, the process of the API.
import { appendFile } from "node:fs/promises";
import { createRequire } from "node:module";

const [web, executablePath, link, address, folder, changing, pictures, api] = process.argv.slice(2);
const { chromium } = createRequire(`${web}/package.json`)("playwright-core");
const PATIENCE_MS = 60_000;
const SLOW = 12e6;

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 1280, height: 900 } });
const page = await context.newPage();
page.setDefaultTimeout(PATIENCE_MS);
const results = { errors: [] };
page.on("pageerror", (error) => results.errors.push(error.message));
page.on("dialog", (dialog) => void dialog.accept());
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const panel = page.locator("[data-phase]").first();

async function slow(where, bytesPerSecond) {
  const cable = await context.newCDPSession(where);
  await cable.send("Network.enable");
  const at = { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: bytesPerSecond };
  await cable.send("Network.emulateNetworkConditions", at);
}

async function choose(where, path, button) {
  const [chooser] = await Promise.all([where.waitForEvent("filechooser"), where.getByRole("button", { name: button }).last().click()]);
  await chooser.setFiles(path);
}

async function begin(where) {
  await where.getByRole("button", { name: /^Upload \d+ file/ }).click();
}

async function reaches(percent) {
  await page.waitForFunction(
    (least) => Number(document.querySelector("[data-phase] [role=progressbar]")?.getAttribute("aria-valuenow")) >= least,
    percent,
  );
}

// A new mission; the API is killed, and its supervisor starts it again.
await page.goto(`${address}/upload`);
await choose(page, folder, "Choose a folder");
await page.getByLabel("Project").selectOption({ label: "Alps" });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel("Mission name").fill("descent");
await slow(page, SLOW);
await begin(page);
await reaches(5);
process.kill(Number(api), "SIGKILL");
await panel.getByText("The server does not respond").waitFor();
results.away = await panel.innerText();
await reaches(25);

// The browser has no session any more; once it has one again, as by signing in in another window, it goes on.
const session = await context.cookies();
await context.clearCookies();
await page.getByRole("dialog").getByRole("button", { name: "Sign in" }).waitFor();
await page.locator("[data-phase=signed_out]").waitFor(); // the page may have been told before the upload was
results.signedOut = await panel.innerText();
await page.screenshot({ path: `${pictures}/upload-signed-out.png` });
await context.addCookies(session);
await page.evaluate(() => globalThis.dispatchEvent(new Event("focus")));
await page.locator("[data-phase=running]").waitFor();
await reaches(40);

// Another tab uploads into the same mission, which must not be done before that tab is there.
await slow(page, SLOW / 10);
const mission = (await panel.getByRole("link", { name: "descent" }).getAttribute("href")).split("/").at(-1);
const elsewhere = await context.newPage();
elsewhere.setDefaultTimeout(PATIENCE_MS);
await elsewhere.goto(`${address}/upload?mission=${mission}`);
await elsewhere.locator("[data-unfinished]").waitFor();
results.other = await elsewhere.locator("[data-unfinished]").innerText();
await choose(elsewhere, changing, "Choose files");
await begin(elsewhere);
await elsewhere.locator("[data-phase=elsewhere]").waitFor();
results.elsewhere = await elsewhere.locator("[data-phase]").innerText();
await elsewhere.close();
await slow(page, -1);
await page.locator("[data-phase=over]").waitFor();
results.over = await panel.innerText();

// A file is written to while it is on its way.
await page.goto(`${address}/upload?mission=${mission}`);
await slow(page, SLOW);
await choose(page, changing, "Choose files");
await begin(page);
await reaches(10);
await appendFile(changing, "one more message");
await page.locator("[data-phase=over]").waitFor();
results.changed = await panel.innerText();

// It is chosen anew, and given up.
await panel.getByRole("button", { name: "Close" }).click();
await choose(page, changing, "Choose files");
await begin(page);
await reaches(10);
await panel.getByRole("button", { name: "Cancel" }).click();
await page.getByRole("button", { name: "Cancel upload" }).click();
await page.locator("[data-phase=cancelled]").waitFor();
results.cancelled = await panel.getByRole("status").first().innerText();
await page.goto(`${address}/upload`);
await page.getByRole("button", { name: "Choose files" }).waitFor();
results.left = await page.locator("[data-unfinished]").count();
await browser.close();
process.stdout.write(JSON.stringify(results));
