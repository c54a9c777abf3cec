// Search: opens it by a key, adds terms by typing and clicking, enters an invalid query, opens a file and returns, sets
// labels, shares the selected file, downloads results by a script, and uses the map of missions.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the
// server's address, the folder for screenshots, the id of a project.
import { readFile } from "node:fs/promises";
import { openBrowser } from "./browsing.mjs";
import { useMissionsMap } from "./missions_map.mjs";

const [web, executablePath, link, address, pictures, project] = process.argv.slice(2);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let expectsErrors = false;
// The server of the tiles refuses half of them, whenever the map asks for one.
const { page } = await openPage((url) => expectsErrors || url.includes("/tiles/"));
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const box = page.getByRole("textbox", { name: "Search files, missions, and topics" });
const query = () => page.locator("[data-results]").getAttribute("data-query");
const tabs = () => page.locator("[data-results] nav a").allInnerTexts();
const rows = () => page.locator("[data-results] [data-row-link]").allInnerTexts();
const urlQuery = () => new URL(page.url()).searchParams.get("q");

async function waitForResults(expectedQuery) {
  await page.waitForFunction((text) => document.querySelector("[data-results]")?.getAttribute("data-query") === text, expectedQuery);
  await page.waitForFunction(() => document.querySelector("[data-results] [aria-busy]") === null);
}

await page.locator("[data-recent] [data-row-link]").first().waitFor();
await page.locator("[data-attention] li").first().waitFor();
results.home = await page.locator("main").innerText();

await page.keyboard.press("/"); // this page has no search box: opens the search
await page.waitForURL((url) => url.pathname === "/search");
await waitForResults("");
results.tabs = await tabs();
await page.keyboard.press("/");
await page.keyboard.type("alps topic:/imu/* format:mcap");
await waitForResults("alps topic:/imu/* format:mcap");
results.typed = { urlQuery: urlQuery(), tabs: await tabs(), rows: await rows(), command: await page.locator("[data-command] pre").innerText() };
await checkPage(page, "search-typed");

// While a search is in progress, the previous results are greyed but readable.
const delayedRequests = [];
const searches = /\/api\/v1\/search\?/;
await page.route(searches, (route) => delayedRequests.push(route));
await box.fill("alps");
await page.locator("[data-results].stale").waitFor();
await checkPage(page, "search-stale");
for (const route of delayedRequests) await route.continue();
await page.unroute(searches);
await waitForResults("alps");
await box.fill("alps topic:/imu/* format:mcap");
await waitForResults("alps topic:/imu/* format:mcap");

await box.press("ArrowDown");
await page.waitForFunction(() => document.activeElement?.hasAttribute("data-row-link"));
await page.keyboard.press("ArrowDown");
await page.waitForFunction(() => document.activeElement?.closest("[data-index]")?.getAttribute("data-index") === "1");
const second = (await rows())[1].split("\n")[0];
await page.keyboard.press("Enter");
await page.waitForURL((url) => url.pathname.startsWith("/files/"));
await page.getByRole("heading", { level: 1 }).filter({ hasText: second }).waitFor();
await page.goBack();
await waitForResults("alps topic:/imu/* format:mcap");
results.back = { urlQuery: urlQuery(), box: await box.inputValue() };

await page.getByRole("region", { name: "Month" }).getByRole("link").first().click();
await page.waitForFunction(() => document.querySelector("[data-results]")?.getAttribute("data-query").includes("month:"));
results.faceted = { query: await query(), box: await box.inputValue() };
await page.getByRole("region", { name: "Month" }).getByRole("link", { name: /^selected/ }).click();
await waitForResults("alps topic:/imu/* format:mcap");

expectsErrors = true;
await box.fill("alps size:big");
await box.press("Enter");
await page.locator("[data-wrong]").waitFor();
results.invalid = { message: await page.locator("[data-wrong]").innerText(), mark: await page.locator("[data-wrong] mark").innerText(), rows: (await rows()).length };
await checkPage(page, "search-wrong");
expectsErrors = false;

await box.fill('mission:"Wet *"');
await box.press("Enter");
await waitForResults('mission:"Wet *"');
await page.getByRole("link", { name: /^Missions/ }).click();
await page.waitForURL((url) => url.searchParams.get("tab") === "missions");
await page.locator("[data-results] [data-row-link]").first().waitFor();
results.markup = { rows: await rows(), elements: await page.locator("[data-results] :not([data-thumbnail]) > img, [data-results] b").count() };
await page.getByRole("link", { name: /^Topics/ }).click();
await page.waitForURL((url) => url.searchParams.get("tab") === "topics");
await page.getByRole("link", { name: "/imu/data" }).first().waitFor();
await page.locator("[data-results] [data-row-link]", { hasText: "/imu/data" }).click();
await page.waitForURL((url) => url.searchParams.get("tab") === "files");
await page.waitForFunction(() => document.querySelector("[data-results]")?.getAttribute("data-query").includes("topic:/imu/data"));
results.topic = await query();

await box.fill("alps format:mcap");
await box.press("Enter");
await waitForResults("alps format:mcap");
await page.getByRole("checkbox", { name: "Select all" }).click();
await page.getByRole("button", { name: "Label" }).click();
await page.getByRole("textbox", { name: "Add" }).fill("paper, icra 27");
await checkPage(page, "search-labels");
await page.getByRole("button", { name: "Change labels" }).click();
await page.getByText(/^Labels of .* changed/).waitFor();
await page.getByRole("dialog").waitFor({ state: "detached" });
results.isShareDisabledForTwoMissions = await page.getByRole("button", { name: "Share" }).isDisabled();
await page.getByRole("button", { name: "Clear selection" }).click();

// A link to the selected file, for an anonymous visitor.
const place = (await rows())[0].split("\n").at(-1);
await page.getByRole("checkbox", { name: "Select drive.mcap" }).first().click();
await page.getByRole("button", { name: "Share" }).click();
const sharing = page.getByRole("dialog", { name: "Share with a link" });
await sharing.getByRole("radio", { name: "1 selected file" }).waitFor();
results.shared = { place, isSelectionChecked: await sharing.getByRole("radio", { name: "1 selected file" }).isChecked() };
await checkPage(page, "search-share");
await sharing.getByRole("button", { name: "Create link" }).click();
const secret = (await sharing.locator("[data-secret] pre").innerText()).trim();
await sharing.getByRole("button", { name: "I saved it" }).click();
await sharing.waitFor({ state: "detached" });

await page.getByRole("button", { name: "Download" }).first().click();
const dialog = page.getByRole("dialog", { name: "Download results" });
await dialog.locator("strong").waitFor();
results.downloadSize = await dialog.locator("strong").innerText();
await checkPage(page, "search-download");
const [script] = await Promise.all([page.waitForEvent("download"), dialog.getByRole("button", { name: "Save as a script" }).click()]);
results.script = await readFile(await script.path(), "utf8");

results.map = await useMissionsMap(page, address, project, checkPage);

// An anonymous visitor sees public projects only.
const { page: anonymous } = await openPage(() => true); // the page requests the account, which is refused with 401
await anonymous.goto(`${address}/public`);
await anonymous.getByRole("link", { name: "Lakes" }).waitFor();
results.public = await anonymous.locator("[data-row-link]").allInnerTexts();
await anonymous.getByRole("link", { name: "Search public projects" }).click();
await anonymous.locator("[data-results] [data-row-link]").first().waitFor();
results.publicRows = await anonymous.locator("[data-results] [data-row-link]").allInnerTexts();
results.publicCheckboxes = await anonymous.getByRole("checkbox").count();

// The link shows the selected file only.
await anonymous.goto(secret);
await anonymous.locator("#files tr").first().waitFor();
results.shared.text = await anonymous.locator("main").innerText();
results.shared.rows = await anonymous.locator("#files tr").allInnerTexts();
await printResults();
