// Downloads selections of recordings into a file, and the first one also as a browser that cannot write files. Prints the
// SHA-256 of each as JSON, by name. Arguments: the folder with playwright-core, the browser, a sign-in link, the
// server's address, the selections as JSON: { name, file, topics (null: all), from and to (seconds; null: the ends) }.
import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import { launchBrowser } from "./chromium.mjs";
import { isEnvironmentError } from "./console_errors.mjs";

const [web, executablePath, link, address, selections] = process.argv.slice(2);
const browser = await launchBrowser(web, executablePath);
const results = { files: {}, downloads: {}, commands: {}, consoleErrors: [] };
const sha256 = (bytes) => createHash("sha256").update(bytes).digest("hex");

const context = await browser.newContext({ acceptDownloads: true });

/** Opens a page whose browser can write files (into its private file system), or cannot. */
async function openPage(canWrite) {
  const page = await context.newPage();
  await page.addInitScript((can) => {
    const pick = async ({ suggestedName }) => (await navigator.storage.getDirectory()).getFileHandle(suggestedName, { create: true });
    window.showSaveFilePicker = can ? pick : undefined;
  }, canWrite);
  page.on("console", (message) => message.type() === "error" && !isEnvironmentError(message.text()) && results.consoleErrors.push(message.text()));
  return page;
}

async function select(page, { file, topics, from, to }) {
  await page.goto(`${address}/files/${file}`);
  await page.getByRole("button", { name: "Download selection" }).click();
  const dialog = page.getByRole("dialog");
  await dialog.locator("[data-from]").waitFor();
  if (topics !== null) {
    await dialog.getByRole("checkbox").first().uncheck(); // that of all rows
    for (const topic of topics) await dialog.getByRole("checkbox", { name: topic, exact: false }).check();
  }
  for (const [place, seconds] of [["[data-from]", from], ["[data-to]", to]]) {
    if (seconds === null) continue;
    await dialog.locator(place).fill(String(seconds));
    await dialog.locator(place).blur();
  }
  return dialog;
}

const writing = await openPage(true);
const loading = await openPage(false);
await writing.goto(link);
await writing.waitForURL((url) => url.pathname === "/");
for (const [number, selection] of JSON.parse(selections).entries()) {
  const dialog = await select(writing, selection);
  results.commands[selection.name] = await dialog.locator("pre, code").first().innerText();
  await dialog.locator("[data-download-slice]").click();
  await dialog.locator("[data-saved]").waitFor({ timeout: 60_000 });
  const bytes = await writing.evaluate(async () => {
    const folder = await navigator.storage.getDirectory();
    for await (const [name, handle] of folder.entries()) {
      const buffer = new Uint8Array(await (await handle.getFile()).arrayBuffer());
      await folder.removeEntry(name);
      return btoa(Array.from(buffer, (byte) => String.fromCharCode(byte)).join(""));
    }
    return "";
  });
  results.files[selection.name] = sha256(Buffer.from(bytes, "base64"));
  if (number > 0) continue;
  const other = await select(loading, selection);
  const [download] = await Promise.all([loading.waitForEvent("download"), other.locator("[data-download-slice]").click()]);
  results.downloads[selection.name] = sha256(await readFile(await download.path()));
}
await browser.close();
console.log(JSON.stringify(results));
