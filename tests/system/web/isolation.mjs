// The isolation of runs: an owner allows a weaker class in the settings of a project; a run shows the class that it had and
// where it ran, and leads to the other runs there; admins see the runners.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link of the
// owner, the server's address, the id of the project, the id of the run, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, project, run, pictures] = process.argv.slice(2);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
const { page } = await openPage();
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

// The owner allows namespaces; what the server forbids cannot be chosen.
await page.goto(`${address}/projects/${project}?tab=settings`);
const isolation = page.getByLabel("Weakest isolation of runs");
await isolation.waitFor();
results.before = await isolation.inputValue();
results.disabled = await isolation.locator("option:disabled").allInnerTexts();
results.explained = await page.locator("[data-isolations] dd").count();
await isolation.selectOption("namespaces");
await checkPage(page, "project-isolation");
await page.getByRole("button", { name: "Save" }).click();
await page.getByText("Saved.", { exact: true }).waitFor();
await page.reload();
await page.waitForFunction(() => document.querySelector("select.input option:checked")?.value === "namespaces");
await page.goto(`${address}/projects/${project}?tab=activity`);
await page.getByText("set the isolation of runs in").waitFor();

// A run names its class and its node; the node leads to the runs there.
await page.goto(`${address}/runs/${run}`);
const facts = page.getByRole("complementary", { name: "About" });
await facts.getByRole("link", { name: "gpu07" }).waitFor();
results.facts = await facts.locator("dl").first().innerText();
await checkPage(page, "run-placement");
await facts.getByRole("link", { name: "gpu07" }).click();
await page.getByRole("button", { name: "Remove filter: On gpu07" }).waitFor();
await page.getByRole("row").filter({ hasText: "gpu07, job 4711_3" }).waitFor();
await checkPage(page, "runs-of-node");

await page.goto(`${address}/admin?tab=runners`);
results.runner = await page.getByRole("row").filter({ hasText: "Now" }).innerText();
await checkPage(page, "admin-runners");
await printResults();
