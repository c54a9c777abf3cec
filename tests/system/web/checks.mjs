// Checks and verdicts: writes rules with an error and corrects them, walks the matrix by keys, accepts a check and withdraws
// that, and finds verdicts in lists, search, and runs. Prints the results as JSON. Arguments: the folder with playwright-core
// and axe-core, the browser, a sign-in link, the server's address, the folder for screenshots, and as JSON: the ids of the
// project and the missions, the rules, and rules with an error. What every_page.mjs shows too is checked only there.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures, input] = process.argv.slice(2);
const { project, missions, rules, wrong } = JSON.parse(input);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let isRefused = false;
const { page } = await openPage(() => isRefused);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
const settled = () => page.waitForFunction(() => document.querySelector("main .skeleton, main [aria-busy=true]") === null);

// Rules: an error is shown at its line; the corrected text is saved; a second version is compared with the first.
await page.goto(`${address}/projects/${project}?tab=checks`);
await page.getByText("No missions checked yet").waitFor();
await page.getByRole("button", { name: "Rules" }).first().click();
await page.getByRole("button", { name: "Write it here" }).click();
const editor = page.getByLabel("checks.yaml", { exact: true });
await editor.fill(wrong);
isRefused = true;
await page.getByRole("button", { name: "Save and check all missions" }).click();
await page.locator("[data-fault]").waitFor();
isRefused = false;
results.rules = {
  fault: await page.locator("[data-fault]").innerText(),
  markedLine: await page.locator("[data-rules] .marked").innerText(),
  caretLine: await editor.evaluate((area) => area.value.slice(0, area.selectionStart).split("\n").length),
};
await checkPage(page, "checks-rules-wrong");
await editor.fill(rules);
await page.getByRole("button", { name: "Save and check all missions" }).click();
await page.locator("[data-versions]").getByText("Version 1").waitFor();
await editor.fill(`${rules}# a comment\n`);
await page.getByRole("button", { name: "Save and check all missions" }).click();
await page.locator("[data-versions]").getByText("Version 2").click();
await page.locator("[data-diff] .added").waitFor();
results.rules.versions = await page.locator("[data-versions] .version").count();
results.rules.added = await page.locator("[data-diff] .added > span:last-child").allInnerTexts();
results.rules.removed = await page.locator("[data-diff] .removed > span:last-child").allInnerTexts();

// The matrix: what the server says of both missions, keys, and what a cell says in full.
await page.getByRole("button", { name: "Missions", exact: true }).click();
const rowOf = (id) => page.locator(`[data-matrix] .line:has(a[href*="${id}"])`);
await rowOf(missions.bad).locator("[data-status=error]").first().waitFor();
await rowOf(missions.good).locator("[data-status=ok]").first().waitFor();
await settled();
const cells = (id) => rowOf(id).locator("[role=gridcell][data-status]").evaluateAll((elements) =>
  Object.fromEntries(elements.map((element) => [element.getAttribute("aria-label").split(": ")[0], element.dataset.status])),
);
results.matrix = { missions: await page.locator("[data-matrix] .line").count(), bad: await cells(missions.bad), good: await cells(missions.good) };
// Read before both missions were judged, it follows them.
const week = page.locator("[data-trend] .bars li .visually-hidden").last();
await week.filter({ hasText: "bad" }).waitFor({ state: "attached" });
results.matrix.trend = (await week.innerText()).split(": ")[1].split(", ");
await page.locator("[data-matrix] .line a").first().focus();
for (const key of ["ArrowDown", "ArrowRight", "ArrowRight"]) {
  await page.keyboard.press(key);
  await page.waitForTimeout(100);
}
results.matrix.afterArrows = await page.evaluate(() => ({
  row: document.activeElement.closest("[data-index]")?.dataset.index, column: document.activeElement.closest("[data-column]")?.dataset.column,
}));
await rowOf(missions.bad).locator('[aria-label="topic.gap: Error"]').hover();
await page.locator("[data-explained]").getByText("longest gap").waitFor();
results.matrix.explained = await page.locator("[data-explained]").innerText();
await page.getByRole("button", { name: "Dismiss" }).first().waitFor({ state: "detached" }); // they end by themselves
await checkPage(page, "checks-matrix");
await rowOf(missions.bad).locator('[aria-label="topic.gap: Error"]').focus();
await page.keyboard.press("Enter");
await page.locator("[data-checks] [role=row]").nth(1).waitFor();
results.matrix.opened = new URL(page.url()).pathname;

// An action that the project names.
await page.goto(`${address}/projects/${project}?tab=checks&part=actions`);
await page.locator("[data-add-action]").getByLabel("Action").waitFor();
await page.getByRole("button", { name: "Add action" }).click();
await page.getByText("Choose an action.").waitFor();
await page.locator("[data-add-action] option", { hasText: "verify" }).waitFor({ state: "attached" });
await page.locator("[data-add-action]").getByLabel("Action").selectOption({ label: "verify all (Alps)" });
await page.locator("[data-add-action]").getByLabel("Runs", { exact: true }).selectOption("idle");
await page.getByLabel("Time without changes").fill("0.5.1");
await page.getByText("Enter a number of minutes").waitFor();
await page.getByLabel("Time without changes").fill("1440");
await page.getByRole("button", { name: "Add action" }).click();
await page.locator("[data-action]").waitFor();
results.actions = { added: await page.locator("[data-action]").innerText() };
await page.getByRole("button", { name: "Remove verify all" }).click();
await page.locator("dialog[open]").getByRole("button", { name: "Remove", exact: true }).click();
await page.locator("[data-action]").waitFor({ state: "detached" });
results.actions.left = await page.locator("[data-action]").count();

// The checks of the bad mission: accepted with a reason, with a note, and withdrawn.
await page.goto(`${address}/missions/${missions.bad}?tab=checks`);
await page.locator("[data-checks] [role=row][data-index]").first().waitFor();
const chips = () => page.locator("[data-checks] [role=row][data-index]").evaluateAll((rows) => Object.fromEntries(
  rows.filter((row) => row.querySelector(".chip")).map((row) => [row.querySelector(".mono").textContent, row.querySelector(".chip").textContent.trim()]),
));
results.mission = {
  verdict: await page.locator("header [data-verdict]").getAttribute("data-verdict"),
  statuses: await page.locator("[data-checks] [role=row][data-index] .chip").allInnerTexts(),
  leftOut: await page.locator("[data-summary]").innerText(),
};
const open = (name) => page.locator("[data-checks] [data-row-link]", { hasText: name }).first().click();
await open("topic.gap");
await page.locator("[data-accept]").waitFor();
await page.getByRole("button", { name: "Accept", exact: true }).click();
await page.getByText("Enter a reason.").waitFor();
results.mission.missingReason = await page.getByText("Enter a reason.").innerText();
await checkPage(page, "checks-dialog");
await page.getByLabel("Reason").fill("the gap was a stop");
await page.getByRole("button", { name: "Accept", exact: true }).click();
await page.locator("[data-accepted]").waitFor();
await page.getByRole("textbox", { name: "Note" }).fill("seen by <b>Ada<b>");
await page.getByRole("button", { name: "Add note", exact: true }).click();
await page.locator("[data-check-notes] li").waitFor();
results.mission.note = await page.locator("[data-check-notes] li").innerText();
await page.getByRole("button", { name: "Close" }).last().click();
await page.locator("[data-acceptances]").waitFor();
results.mission.afterAccepting = await chips();
results.mission.acceptances = await page.locator("[data-acceptances]").innerText();
await page.goto(`${address}/projects/${project}?tab=checks`);
await rowOf(missions.bad).locator("[data-status=accepted]").waitFor();
results.matrix.accepted = await rowOf(missions.bad).locator("[data-status=accepted]").getAttribute("title");
await checkPage(page, "checks-matrix-accepted");
await page.goto(`${address}/missions/${missions.bad}?tab=checks`);
await page.locator("[data-acceptances]").waitFor();
await open("topic.gap");
await page.getByRole("button", { name: "Withdraw" }).click();
await page.locator("[data-accept]").waitFor();
await page.getByRole("button", { name: "Close" }).last().click();
results.mission.afterWithdrawing = await chips();
await page.getByLabel("Show history").check();
await page.locator("[data-acceptances] .chip").waitFor();
results.mission.history = (await page.locator("[data-acceptances] .chip").innerText()).trim();

// Verdicts in the list of the project, and in the search.
await page.goto(`${address}/projects/${project}`);
await page.locator("[role=row][data-index] [data-verdict]").nth(1).waitFor();
const verdictIn = (id) => page.locator(`[role=row]:has(a[href*="${id}"]) [data-verdict]`).getAttribute("data-verdict");
results.mission.inProject = { good: await verdictIn(missions.good), bad: await verdictIn(missions.bad) };
const sortedBy = async (sort, first) => {
  await page.getByRole("columnheader", { name: "Checks" }).getByRole("button").click();
  await page.waitForURL((url) => url.searchParams.get("sort") === sort);
  await page.locator(`[role=row][data-index="0"] [data-verdict=${first}]`).waitFor(); // until then, the rows of the earlier order
  return page.locator("[role=row][data-index] [data-verdict]").evaluateAll((all) => all.map(({ dataset }) => dataset.verdict));
};
results.mission.worstFirst = await sortedBy("verdict", "bad");
results.mission.bestFirst = await sortedBy("-verdict", "unchecked");
await checkPage(page, "checks-project");
await page.setViewportSize({ width: 360, height: 780 });
const details = page.getByRole("button", { name: /^Details of/ }).first();
await details.waitFor();
results.detailsEnd = await details.evaluate((button) => button.getBoundingClientRect().right);
await page.setViewportSize({ width: 1440, height: 900 });
await page.goto(`${address}/search?tab=missions&q=verdict:bad`);
await page.locator("[data-results] [role=row][data-index] [data-verdict]").first().waitFor();
await settled();
results.mission.inSearch = await page.locator("[data-results] [data-verdict]").evaluateAll((all) => all.map(({ dataset }) => dataset.verdict));
await page.goto(`${address}/`);
await page.locator("[data-failed-checks]").waitFor();
await settled();
results.home = await page.locator("[data-failed-checks]").innerText();

// Runs: one that found errors is not green.
await page.goto(`${address}/runs`);
await page.locator("[role=row][data-index] .chip").first().waitFor();
await page.locator("[data-row-link]").first().click();
await page.locator("[data-state=done]").waitFor();
results.run = { state: (await page.locator("[data-state=done] .chip").innerText()).trim() };
await page.getByRole("link", { name: /^Checks/ }).click();
await page.locator("[role=row][data-index] .chip").first().waitFor();
results.run.checks = await page.getByRole("table").innerText();
await page.getByRole("link", { name: /^Metrics \d/ }).click();
await page.getByText("method: icp").waitFor();
results.run.metrics = await page.getByRole("table").innerText();
await printResults();
