// Missions: enters invalid and valid metadata, scrolls through ten thousand files, grants and revokes the right of a
// person with another browser, and checks that markup in names is shown as text.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the
// server's address, an invitation for another person, their name, the ids of a project, a mission and a mission with many
// files, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, invitation, guest, project, mission, large, pictures] = process.argv.slice(2);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
const { page } = await openPage();
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

// Metadata that the project's rule refuses, then metadata that it accepts. Markup in it is shown as text.
await page.goto(`${address}/missions/${mission}`);
await page.locator("[data-lanes]").waitFor();
await page.locator("[data-metadata]").waitFor();
results.title = await page.locator("h1").innerText();
const metadata = page.locator("[data-metadata]");
await metadata.getByRole("button", { name: "ada" }).click();
await metadata.getByLabel("operator").fill("ADA 1");
await metadata.getByRole("button", { name: "Save" }).click();
await metadata.getByText("Must match").first().waitFor();
results.refused = await metadata.innerText();
await checkPage(page, "mission-refused");
await metadata.getByLabel("operator").fill("grace");
await metadata.getByRole("button", { name: "Save" }).click();
await metadata.getByRole("button", { name: "grace" }).waitFor();
results.accepted = await metadata.innerText();
// Topics and warnings.
await page.goto(`${address}/missions/${mission}?tab=topics`);
await page.getByRole("table").locator("svg[role=img]").first().waitFor();
results.topics = await page.getByRole("table").innerText();


// Ten thousand files.
await page.goto(`${address}/missions/${large}`);
await page.getByRole("button", { name: "Expand all" }).click();
await page.locator("[role=table][aria-rowcount]").waitFor();
results.rows = Number(await page.getByRole("table").getAttribute("aria-rowcount"));
results.renderedRows = await page.getByRole("row").count();
for (let step = 0; step < 40; step += 1) await page.mouse.wheel(0, 700);
// Rows that were not rendered yet may change the height.
await page.waitForFunction(() => {
  window.scrollTo(0, document.documentElement.scrollHeight);
  return document.body.innerText.includes("frame_9999.txt");
});
results.renderedRowsAtEnd = await page.getByRole("row").count();

// Another person has the page open while their right is granted and revoked.
const { page: other } = await openPage(() => true);
await other.goto(invitation);
await other.getByLabel(/password/i).fill("a long enough password");
await other.getByRole("button", { name: "Create my account" }).click();
await other.waitForURL((url) => url.pathname === "/");
await other.goto(`${address}/missions/${mission}`);
results.beforeGrant = await other.getByRole("alert").first().innerText();
await page.goto(`${address}/projects/${project}?tab=access`);
const form = page.locator("[data-grant-form]");
await form.getByLabel("Person, group, or email address").fill(guest);
await form.getByRole("button", { name: guest }).first().click();
await form.getByRole("button", { name: "Grant", exact: true }).click();
await page.locator(`[data-grant="${guest}"]`).waitFor();
await checkPage(page, "mission-granted");
await other.goto(`${address}/missions/${mission}`);
await other.locator("[data-metadata]").waitFor();
results.granted = await other.locator("h1").innerText();
await page.getByRole("button", { name: `Revoke the right of ${guest}` }).click();
await page.getByRole("button", { name: "Revoke", exact: true }).click();
await page.locator(`[data-grant="${guest}"]`).waitFor({ state: "detached" });
await other.getByRole("alert").first().waitFor(); // without a reload: the server sends an event
results.revoked = await other.getByRole("alert").first().innerText();

// Names and metadata are shown as text in every view of the project.
const countMarkupElements = () => page.evaluate(() => document.querySelectorAll("main :not([data-thumbnail]) > img, main script, main b, main i, main u, main a[href=x]").length);
results.markupElements = [await countMarkupElements()];
for (const name of ["Missions", "Statistics", "Metadata fields", "Activity", "Settings"]) {
  const tab = page.getByRole("navigation", { name: "Views of the project" }).getByRole("link", { name });
  await tab.click();
  await tab.and(page.locator("[aria-current=page]")).waitFor();
  await page.waitForFunction(() => document.querySelector("main .skeleton, main [aria-busy=true]") === null);
  results.markupElements.push(await countMarkupElements());
}
await printResults();
