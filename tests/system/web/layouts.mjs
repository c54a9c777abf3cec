// Layouts of the viewer: saved in one mission, shown in another, changed, and used by a second person.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link of the
// owner, the server's address, the folder for screenshots, the invitation of the second person, and as JSON the ids of
// two missions and the panels of the first as its address writes them.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures, invitation, input] = process.argv.slice(2);
const { first, second, panels } = JSON.parse(input);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);

const viewOf = (mission, names = []) => `${address}/missions/${mission}/view?${names.map((name) => `p=${encodeURIComponent(name)}`).join("&")}`;
const dialog = (page) => page.getByRole("dialog", { name: "Layouts of the project" });
const row = (page, name) => page.locator(`[data-layout="${name}"]`);
const button = (page, name) => page.getByRole("button", { name, exact: true });
const shownPanels = (page) => page.locator("[data-panel]").evaluateAll((all) => all.map((panel) => panel.getAttribute("aria-label")));
const addressPanels = (page) => new URL(page.url()).searchParams.getAll("p");
const notices = (page, text) => page.getByText(text).first().waitFor();

async function openLayouts(page) {
  await button(page, "Layouts").click();
  await dialog(page).waitFor();
}

async function save(page, name, isShared) {
  await dialog(page).getByLabel(/^Name/).fill(name);
  if (isShared) await dialog(page).getByLabel("Share with everybody who reads the project").check();
  await button(page, "Save").click();
}

/** Opens the viewer without panels in its address, and returns those that it shows once there are some. */
async function defaultsOf(page, mission) {
  await page.goto(viewOf(mission));
  await page.locator("[data-panel]").first().waitFor();
  return shownPanels(page);
}

let isRefusing = false;
const { page } = await openPage(() => isRefusing);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
results.automatic = await defaultsOf(page, second);

// Saved in the first mission, one for all and one of one's own; a name that is taken is refused.
await page.goto(viewOf(first, panels));
await page.locator("[data-panel]").nth(panels.length - 1).waitFor();
results.saved = await shownPanels(page);
await openLayouts(page);
await save(page, "Legs", true);
await row(page, "Legs").waitFor();
isRefusing = true;
await save(page, "legs", true);
await dialog(page).getByText("There is already a layout named").waitFor();
isRefusing = false;
await dialog(page).getByLabel("Share with everybody who reads the project").uncheck();
await save(page, "Mine", false);
await row(page, "Mine").waitFor();
await checkPage(page, "viewer-layouts");

// Shown in the second mission, by the keyboard.
await page.goto(viewOf(second));
await page.locator("[data-panel]").first().waitFor();
await button(page, "Layouts").focus();
await page.keyboard.press("Enter");
await button(page, "Show Legs").focus();
await page.keyboard.press("Enter");
await notices(page, "1 panel is not shown: this mission has no such topics.");
await dialog(page).waitFor({ state: "detached" });
await page.waitForFunction(() => document.querySelectorAll("[data-panel]").length === 2);
results.applied = await shownPanels(page);
results.appliedAddress = addressPanels(page);
await page.goBack();
await page.waitForFunction((count) => document.querySelectorAll("[data-panel]").length === count, results.automatic.length);

// As the default, it is shown where the address names no panels.
await openLayouts(page);
await button(page, "Legs as the default of the project").click();
await row(page, "Legs").getByText("Default").waitFor();
results.byDefault = await defaultsOf(page, second);

// Renamed, replaced and deleted.
await openLayouts(page);
await button(page, "Rename Legs").click();
await page.getByRole("dialog", { name: "Rename Legs" }).getByLabel(/^Name/).fill("Arms");
await page.getByRole("dialog", { name: "Rename Legs" }).getByRole("button", { name: "Save" }).click();
await row(page, "Arms").waitFor();
await button(page, "Save the panels as Mine").click();
await button(page, "Replace").click();
await notices(page, "Layout Mine saved.");
await button(page, "Delete Mine").waitFor();

// A second person who may only read sees the shared one, and saves one of their own.
const { page: reader } = await openPage();
await reader.goto(invitation);
await reader.getByLabel(/password/i).fill("a long enough password");
await reader.getByRole("button", { name: "Create my account" }).click();
await reader.waitForURL((url) => url.pathname === "/");
results.readerDefault = await defaultsOf(reader, second);
await openLayouts(reader);
await row(reader, "Arms").waitFor();
results.readerLayouts = await reader.locator("[data-layout]").evaluateAll((all) => all.map(({ dataset }) => dataset.layout));
results.readerButtons = await row(reader, "Arms").getByRole("button").evaluateAll((all) => all.map((one) => one.getAttribute("aria-label")));
results.readerShares = await dialog(reader).getByLabel("Share with everybody who reads the project").count();
await save(reader, "Mine", false);
await row(reader, "Mine").waitFor();

// A change reaches the other open page.
await button(page, "Delete Arms").click();
await page.getByRole("dialog", { name: "Delete Arms?" }).getByRole("button", { name: "Delete", exact: true }).click();
await row(page, "Arms").waitFor({ state: "detached" });
await row(reader, "Arms").waitFor({ state: "detached" });
results.ownerLayouts = await page.locator("[data-layout]").evaluateAll((all) => all.map(({ dataset }) => dataset.layout));
await printResults();
