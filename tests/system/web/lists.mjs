// Lists of missions: sorts and filters them by metadata, changes and downloads several at once, opens hidden columns on a
// phone, and checks what a person without rights sees.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the
// server's address, an invitation for another person, a share link, the id of a project, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, invitation, share, project, pictures] = process.argv.slice(2);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
const { context, page } = await openPage();
// The browser's private folder replaces the folder picker, whose window a program cannot operate.
await context.addInitScript(() => (window.showDirectoryPicker = () => navigator.storage.getDirectory()));
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const names = async () => (await page.locator("main [data-index] [data-row-link]").allInnerTexts()).map((text) => text.trim());
await page.goto(`${address}/projects/${project}`);
await page.getByRole("row", { name: /mild/ }).waitFor();
for (const order of ["ascending", "descending"]) {
  await page.getByRole("button", { name: "temperature" }).click();
  await page.locator(`[aria-sort=${order}]`, { hasText: "temperature" }).waitFor();
  await page.waitForFunction(() => document.querySelector("main [aria-busy=true], .progress.busy") === null);
  results[order] = await names();
}
await page.getByRole("button", { name: "Filter by metadata" }).click();
await page.getByLabel("Value").selectOption("spot");
await page.getByRole("button", { name: "Apply" }).click();
await page.getByRole("row", { name: /cold/ }).waitFor({ state: "detached" });
results.filtered = await names();
await page.getByRole("button", { name: "Clear filters" }).click();

// Bulk actions on two missions: setting metadata, downloading, deleting.
for (const name of ["cold", "mild"]) await page.getByRole("checkbox", { name: `Select ${name}` }).check();
await page.getByRole("button", { name: "Set metadata" }).click();
const dialog = page.getByRole("dialog");
await dialog.getByLabel("Field").selectOption("operator");
await dialog.getByLabel("Value").fill("grace");
await checkPage(page, "lists-metadata");
await dialog.getByRole("button", { name: "Save" }).click();
await dialog.waitFor({ state: "detached" });
await page.getByRole("button", { name: "Download", exact: true }).click();
const chooseFolder = dialog.getByRole("button", { name: "Choose a folder" });
await chooseFolder.click();
await dialog.locator("[data-saved]").waitFor();
results.downloads = [await dialog.locator("[data-saved]").innerText()];
await chooseFolder.click();
await dialog.getByText("already present").waitFor();
results.downloads.push(await dialog.locator("[data-saved]").innerText());
results.command = await dialog.locator("pre").innerText();
await checkPage(page, "lists-download");
results.downloadedFiles = await page.evaluate(async () => {
  const contents = {};
  async function walk(folder, path) {
    for await (const [name, handle] of folder.entries()) {
      if (handle.kind === "directory") await walk(handle, `${path}${name}/`);
      else contents[path + name] = await (await handle.getFile()).text();
    }
  }
  await walk(await navigator.storage.getDirectory(), "");
  return contents;
});
await page.keyboard.press("Escape");
await page.getByRole("button", { name: "Delete", exact: true }).click();
await dialog.getByRole("button", { name: "Delete", exact: true }).click();
await page.getByRole("row", { name: /mild/ }).waitFor({ state: "detached" });
results.remaining = await names();

await page.setViewportSize({ width: 390, height: 844 });
await page.getByRole("button", { name: "Details of hot" }).click();
results.details = await page.locator(".details").innerText();
await checkPage(page, "lists-phone");

await page.goto(share);
for (let times = 0; times < 2; times += 1) {
  await page.evaluate(() => (document.getElementById("progress").textContent = "")); // clears the result of the first download
  await page.getByRole("button", { name: /^Download all/ }).click();
  await page.locator("#progress", { hasText: "downloaded" }).waitFor();
}
results.shared = await page.locator("#progress").innerText();
await checkPage(page, "lists-share");

const { page: other } = await openPage(() => true);
await other.goto(invitation);
await other.getByLabel(/password/i).fill("a long enough password");
await other.getByRole("button", { name: "Create my account" }).click();
await other.waitForURL((url) => url.pathname === "/");
await other.locator("[data-no-access]").waitFor();
results.noAccess = [await other.locator("[data-no-access]").innerText()];
await other.goto(`${address}/projects`);
await other.locator("[data-no-access]").waitFor();
await checkPage(other, "lists-no-access");
await printResults();
