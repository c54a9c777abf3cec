// The library: adds shipped actions from the page of actions and from a project, by mouse and by keys; what a project has
// already, and what cannot be added. Prints the results as JSON. Arguments: the folder with playwright-core and axe-core,
// the browser, a sign-in link, the server's address, the folder for screenshots, and the id of a project.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures, project] = process.argv.slice(2);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let isRefused = false;
const { page } = await openPage(() => isRefused);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
const dialog = page.locator("dialog[open]");
const shipped = (name) => dialog.locator(`[data-shipped="kleinkram/${name}"]`);
const choosePlace = async (label) => {
  await dialog.getByLabel("Add to").selectOption({ label });
  await page.waitForLoadState("networkidle");
};

// By keys, from the page of actions.
await page.goto(`${address}/actions`);
await page.getByRole("button", { name: "Add from library" }).focus();
await page.keyboard.press("Enter");
await shipped("slam-evaluate").waitFor();
results.names = await dialog.locator("[data-shipped]").evaluateAll((items) => items.map((item) => item.dataset.shipped));
results.text = await shipped("slam-evaluate").innerText();
results.disabledBefore = await dialog.locator("[data-shipped] button:disabled").count();
await page.keyboard.press("Escape");
await dialog.waitFor({ state: "detached" });
await page.getByRole("button", { name: "Add from library" }).and(page.locator(":focus")).waitFor();
await page.keyboard.press("Enter");
await choosePlace("Alps");
await checkPage(page, "library");
await dialog.getByRole("button", { name: "Add kleinkram/slam-evaluate" }).focus();
await page.keyboard.press("Enter");
await page.waitForURL(/\/actions\/[0-9a-f-]{36}/);
await page.locator("dl.facts").waitFor();
results.action = { title: await page.locator("h1").innerText(), facts: await page.locator("dl.facts").innerText() };

// The list says where it is from; in the dialog it is added, also after a reload.
await page.goto(`${address}/actions`);
results.row = await page.locator("[data-index]", { hasText: "Alps" }).innerText();
await page.getByRole("button", { name: "Add from library" }).click();
await choosePlace("Alps");
await shipped("slam-evaluate").getByText("Added").waitFor();
results.added = { text: await shipped("slam-evaluate").innerText(), buttons: await shipped("slam-evaluate").locator("button").count() };
await choosePlace("All projects");
await shipped("slam-evaluate").getByText("Added").waitFor({ state: "detached" });

// A package that the index does not have: the refusal is beside the action, and nothing is added.
await choosePlace("Alps");
isRefused = true;
await dialog.getByRole("button", { name: "Add kleinkram/lidar-odometry" }).click();
await shipped("lidar-odometry").getByRole("alert").waitFor();
results.refused = await shipped("lidar-odometry").getByRole("alert").innerText();
await checkPage(page, "library-refused");
isRefused = false;

// An action of somebody has the name.
await choosePlace("Lakes");
await shipped("slam-evaluate").getByText("Name in use").waitFor();
results.taken = { text: await shipped("slam-evaluate").innerText(), buttons: await shipped("slam-evaluate").locator("button").count() };

// An earlier Kleinkram added it: the newer version is added.
await choosePlace("Moors");
await shipped("slam-evaluate").getByText("Update available").waitFor();
await checkPage(page, "library-update");
await dialog.getByRole("button", { name: "Add newer version of kleinkram/slam-evaluate" }).click();
await page.waitForURL(/\/actions\/[0-9a-f-]{36}/);
await page.locator("dl.facts").waitFor();
results.upgraded = await page.locator("section h2").first().innerText();

// From the actions of a project: the added action is chosen in its form.
await page.goto(`${address}/projects/${project}?tab=checks&part=actions`);
await page.locator("[data-add-action]").getByRole("button", { name: "Add from library" }).click();
await shipped("slam-evaluate").waitFor();
results.place = await dialog.getByLabel("Add to").locator("option:checked").innerText();
await dialog.getByRole("button", { name: "Add kleinkram/slam-evaluate" }).click();
await dialog.waitFor({ state: "detached" });
await page.locator("[data-add-action]").getByLabel("alignment").waitFor();
results.chosen = await page.locator("[data-add-action]").getByLabel("Action").locator("option:checked").innerText();
await printResults();
