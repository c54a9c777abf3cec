// Runs: launches an action on a mission by the form of its parameters, watches the run, reads its results, and follows
// their links to the mission and the file; then launches it on several missions, and cancels a run.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the
// server's address, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures] = process.argv.slice(2);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
const { page } = await openPage();
const tab = (name) => page.getByRole("navigation", { name: "Parts of this run" }).getByRole("link", { name });
const rows = async () => {
  await page.locator("main [data-index]:not(:has(.coming))").first().waitFor();
  return page.locator("main [data-index]").allInnerTexts();
};
const ended = (state) => page.locator(`[data-state="${state}"]`).waitFor();
const runNow = page.getByRole("button", { name: /^Run$|^Run on \d/ });

await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
await page.goto(`${address}/actions`);
await page.locator("main [data-row-link]").first().waitFor();
await checkPage(page, "actions");
await page.locator("main [data-row-link]").first().click();
await page.getByText("Show script").click();
await checkPage(page, "action");

// Opens the form from the mission. It shows errors beside its fields.
await page.goto(`${address}/projects`);
await page.locator("main [data-row-link]", { hasText: "Alps" }).click();
await page.locator("main [data-row-link]", { hasText: "Wet" }).click();
await page.getByRole("link", { name: "Run…" }).click();
await page.getByLabel("Action").selectOption({ index: 1 });
await page.getByLabel("speed").fill("11");
await runNow.click();
results.fieldErrors = await page.locator("form [id$='-error']").allInnerTexts();
await page.waitForFunction(() => document.querySelectorAll("datalist option").length > 0);
results.topics = await page.locator("datalist option").evaluateAll((all) => all.map(({ value }) => value));
await checkPage(page, "launch");
await page.getByLabel("top", { exact: false }).first().fill("/imu/data");
await page.getByLabel("speed").fill("3");
await page.getByLabel("slow").selectOption("true");
await runNow.click();

// The run while it is active, and its log after its end.
await page.waitForURL((url) => /^\/runs\/[0-9a-f-]{36}$/.test(url.pathname));
const run = page.url();
await page.locator("progress").waitFor();
results.active = { progress: await page.getByText("half of it").first().innerText() };
await checkPage(page, "run-live");
await ended("done");
await page.locator("[data-log][data-over]").waitFor();
await page.getByText("the very end").waitFor();
const lines = page.locator("[data-log] .line");
results.log = { last: (await lines.allInnerTexts()).at(-1), renderedLines: await lines.count() };
await page.getByPlaceholder("Search the log").fill("LINE 1234");
await page.locator("[data-log] .found").waitFor();
results.log.matches = await page.locator("[data-log] [role=status]").innerText();
results.log.visibleLines = await lines.allInnerTexts();
await checkPage(page, "run-log");

// Its report and its artifacts.
await page.locator("main figure svg").first().waitFor();
await page.locator("main td").first().waitFor();
await page.waitForFunction(() => [...document.querySelectorAll("main img")].some((image) => image.naturalWidth > 0));
results.previews = {
  pictures: await page.locator("main img").count(),
  inline: await page.locator("main svg script, main svg[onload]").count(),
  track: await page.locator("main figure svg").getAttribute("aria-label"),
  cells: await page.locator("main td").allInnerTexts(),
};
await tab(/^Findings/).click();
results.findings = await rows();
results.findingLink = await page.locator("main [data-index] a").first().getAttribute("href");
await checkPage(page, "run-findings");
await tab(/^Metrics/).click();
await page.getByText("ate_rmse").waitFor();
results.metrics = await rows();
await tab(/^Artifacts/).click();
await page.getByText("table.csv").first().waitFor();
results.artifacts = (await rows()).map((text) => text.split("\n")[0]);
const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Download table.csv" }).click()]);
results.downloaded = download.suggestedFilename();
await tab(/^Inputs/).click();
await rows();
await tab(/^Action/).click();
await page.getByText("Show script").waitFor();
await page.locator("[data-proposed]").getByRole("button", { name: "Apply all" }).click();
await page.getByText("The mission already has these values.").waitFor();
await page.getByRole("link", { name: /^Wet/ }).first().click();
await page.locator("[data-metadata]").getByText("anymal").waitFor();
results.appliedMetadata = Object.fromEntries(await page.locator("[data-metadata] .value").evaluateAll((all) => all.map((entry) => [entry.querySelector("dt")?.textContent, entry.querySelector("dd")?.textContent?.trim()])));
await page.getByRole("navigation", { name: "Views of the mission" }).getByRole("link", { name: "Runs" }).click();
await rows();
await checkPage(page, "mission-runs");

// The lineage of the file.
await page.goto(`${address}${results.findingLink}`);
await page.locator("[data-lineage]").waitFor();
results.lineage = await page.locator("[data-lineage]").innerText();
await checkPage(page, "file-lineage");
await page.getByRole("button", { name: "Delete" }).click();
await page.getByRole("dialog").getByText("These results of runs on this file are kept").waitFor();
results.deletionWarning = await page.getByRole("dialog").innerText();
await checkPage(page, "file-deletion");
await page.getByRole("button", { name: "Cancel" }).click();

// Runs it again, launches it on several missions, and cancels a run.
await page.goto(run);
await page.getByRole("button", { name: "Run again" }).click();
await page.waitForURL((url) => url.href !== run && /^\/runs\/[0-9a-f-]{36}$/.test(url.pathname));
await ended("done");
results.secondRun = { state: await page.locator("[data-state]").getAttribute("data-state") };
await page.goto(`${address}/runs/new`);
await page.getByLabel("Action").selectOption({ index: 1 });
for (const name of ["Add Alps / night", /^Add Alps . Wet/]) await page.getByRole("button", { name }).click();
await page.getByLabel("top", { exact: false }).first().fill("/odom");
await page.getByLabel("slow").selectOption("true");
await page.getByRole("checkbox", { name: /^Run even if/ }).check();
await runNow.click();
await page.locator("[data-outcome]").waitFor();
results.batch = { launched: await page.locator("[data-outcome] .line").first().innerText() };
await checkPage(page, "launched");
await page.getByRole("link", { name: "Show runs" }).click();
await page.waitForFunction(() => document.querySelectorAll("main [data-index] [data-row-link]").length >= 4);
results.batch.runs = await rows();
await checkPage(page, "runs");
await page.locator("main [data-row-link]").first().click();
await page.getByRole("button", { name: "Cancel" }).click();
await page.getByRole("dialog").getByRole("button", { name: "Cancel" }).last().click();
await ended("cancelled");
results.cancelled = await page.locator("[data-state]").getAttribute("data-state");
await checkPage(page, "run-cancelled");
await printResults();
