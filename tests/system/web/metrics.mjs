// Tables of metrics: from a project to the table of a metric, cells by keys, columns, a comparison, copies, a link that shows the
// same, and the way from the metric of a run. Prints the results as JSON. Arguments: the folder with playwright-core and axe-core,
// the browser, a sign-in link, the server's address, the folder for screenshots, and as JSON: the project and a run.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures, input] = process.argv.slice(2);
const { project, run } = JSON.parse(input);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let isRefused = false;
const { page, context } = await openPage(() => isRefused);
await context.grantPermissions(["clipboard-read", "clipboard-write"], { origin: address });
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
const settled = () => page.waitForFunction(() => document.querySelector("main .skeleton, main [aria-busy=true], main .stale") === null);
const table = page.locator("[data-metrics]");
const headings = async () => (await table.locator("[role=columnheader]").allInnerTexts()).map((text) => text.replaceAll("\n", ", "));
const cells = () => table.locator("[data-index]").evaluateAll((rows) => rows.map((row) => [...row.querySelectorAll("[role=rowheader], [role=gridcell]")].map(
  (cell) => [cell.innerText.replaceAll(/\s+/g, " ").trim(), cell.dataset.rank ?? cell.dataset.missing].filter(Boolean).join(" | "),
)));

// From the project to the table of a metric.
await page.goto(`${address}/projects/${project}`);
await page.getByRole("link", { name: "Metrics" }).last().click();
await page.getByText("The table then shows its latest results").waitFor();
await checkPage(page, "metrics-start");
await page.getByLabel("Metric", { exact: true }).selectOption("ate_rmse");
await table.locator("[data-index]").first().waitFor();
await settled();
results.table = { address: new URL(page.url()).search, caption: await page.locator("[data-caption]").innerText(), headings: await headings(), cells: await cells() };
results.table.varying = await page.locator("[data-varying]").innerText();
await checkPage(page, "metrics-table");

// Cells by keys: what a cell is made of, and its run.
await table.locator("[data-index] a").first().focus();
for (const key of ["ArrowDown", "ArrowRight"]) {
  await page.keyboard.press(key);
  await page.waitForTimeout(100);
}
await table.locator("[data-explained] a").first().waitFor();
results.explained = await table.locator("[data-explained]").innerText();
await page.keyboard.press("Enter");
await page.waitForURL(/\/runs\//);
await page.goBack();
await table.locator("[data-index]").first().waitFor();
results.afterReturn = await cells();

// A column more, and a comparison, which a link shows again.
await page.locator('[data-column-choice="param.method"]').click();
await page.locator("[data-varying]").waitFor({ state: "detached" });
await settled();
results.byMethod = { headings: await headings(), cells: await cells() };
await page.locator('[data-column-choice="param.method"]').click();
await page.locator("[data-varying]").waitFor();
await settled();
await page.getByLabel("Compare column").selectOption(results.table.headings[1]);
await page.getByLabel("with column").selectOption(results.table.headings[2]);
await page.locator("[data-comparison]").waitFor();
await table.locator("[data-difference]").first().waitFor();
await settled();
results.compared = { text: await page.locator("[data-comparison]").innerText(), cells: await cells() };
await page.reload();
await page.locator("[data-comparison]").waitFor();
await settled();
results.afterReload = { text: await page.locator("[data-comparison]").innerText(), cells: await cells() };
await checkPage(page, "metrics-compared");
results.copies = {};
for (const format of ["CSV", "Markdown", "LaTeX"]) {
  await page.getByRole("button", { name: format }).click();
  await page.getByText(`Copied the table as ${format}.`).waitFor();
  results.copies[format] = await page.evaluate(() => navigator.clipboard.readText());
}

// Rows by project, all rows, a condition, and one that the server refuses.
await page.getByLabel("Show rows without runs").check();
await table.getByText("never run").waitFor();
results.allRows = (await cells()).length;
await page.getByLabel("Condition").fill("param.method=slow");
await page.keyboard.press("Enter");
await table.getByText("0.7000").waitFor();
await settled();
results.filtered = await headings();
results.gone = await page.locator("[data-gone]").innerText();
isRefused = true;
await page.getByLabel("Condition").fill("param.method<slow");
await page.getByRole("button", { name: "Add" }).click();
await page.getByText("compared with = or !=").waitFor();
await checkPage(page, "metrics-refused");
isRefused = false;

// From the metric of a run.
await page.goto(`${address}/runs/${run}?tab=metrics`);
await page.getByRole("link", { name: "ate_rmse" }).click();
await table.locator("[data-index]").first().waitFor();
results.fromRun = new URL(page.url()).search;
await printResults();
