// Uploads a file from a browser on another machine, opens its preview, and downloads it. Prints the results as JSON.
// Arguments: the folder with playwright-core, the browser, a sign-in link, the server's address, the file, the folder for
// screenshots.
import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import { launchBrowser } from "./chromium.mjs";

const [web, executablePath, link, address, file, pictures] = process.argv.slice(2);
const TIMEOUT_MS = 60_000;

const browser = await launchBrowser(web, executablePath);
const page = await (await browser.newContext({ viewport: { width: 1280, height: 900 }, acceptDownloads: true })).newPage();
page.setDefaultTimeout(TIMEOUT_MS);
const results = { consoleErrors: [] };
page.on("pageerror", (error) => results.consoleErrors.push(error.message));
// Over plain HTTP from another machine, the browser reports for each page that it ignores this header.
const IGNORED_HEADER = /^The Cross-Origin-Opener-Policy header has been ignored/;
page.on("console", (message) => message.type() === "error" && !IGNORED_HEADER.test(message.text()) && results.consoleErrors.push(message.text()));
const hosts = new Set();
page.on("request", (request) => {
  const { origin, protocol } = new URL(request.url());
  if (protocol.startsWith("http")) hosts.add(`${request.method()} ${origin}`);
});
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
await page.goto(`${address}/upload`);
const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Choose files" }).click()]);
await chooser.setFiles(file);
await page.getByLabel("Project").selectOption({ label: "Alps" });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel("Mission name").fill("far");
await page.getByRole("button", { name: /^Upload 1 file/ }).click();
await page.locator("[data-phase=over]").waitFor().catch(async (error) => {
  throw new Error(await page.locator("main").innerText(), { cause: error });
});
results.finished = await page.locator("[data-phase]").first().innerText();
await page.locator("[data-phase]").getByRole("link", { name: "far" }).click();
await page.getByRole("link", { name: "drive.mcap" }).first().click();
await page.locator("[data-log-time]").waitFor().catch(async (error) => {
  throw new Error(await page.locator("main").innerText(), { cause: error });
});
await page.screenshot({ path: `${pictures}/lasting-far.png` });
const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Download" }).or(page.getByRole("link", { name: "Download" })).first().click()]);
results.sha256 = createHash("sha256").update(await readFile(await download.path())).digest("hex");
results.hosts = [...hosts];
await browser.close();
process.stdout.write(JSON.stringify(results));
