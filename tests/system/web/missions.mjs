// What people do with missions: say metadata that is refused and then accepted, scroll ten thousand files, give a right
// to somebody who looks on in another browser and take it away, and meet names that are full of markup.
// Prints as JSON what was seen. Arguments: the folder with playwright-core and axe-core, the browser, a link that signs
// in, the server's address, an invitation for somebody else, their name, ids of project, mission, and the large mission,
// where pictures go.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, invitation, guest, project, mission, large, pictures] = process.argv.slice(2);
const { results, somebody, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
const { page } = await somebody();
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

// Metadata, refused by the project's own rule and then accepted; markup in it is text.
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
// Topics and what is odd.
await page.goto(`${address}/missions/${mission}?tab=topics`);
await page.getByRole("table").locator("svg[role=img]").first().waitFor();
results.topics = await page.getByRole("table").innerText();


// Ten thousand files.
await page.goto(`${address}/missions/${large}`);
await page.getByRole("button", { name: "Expand all" }).click();
await page.locator("[role=table][aria-rowcount]").waitFor();
results.rows = Number(await page.getByRole("table").getAttribute("aria-rowcount"));
results.drawn = await page.getByRole("row").count();
for (let at = 0; at < 40; at += 1) await page.mouse.wheel(0, 700);
await page.evaluate(() => window.scrollTo(0, document.documentElement.scrollHeight));
await page.getByText("frame_9999.txt").waitFor();
results.drawnAtEnd = await page.getByRole("row").count();

// Somebody else looks on while a right is given and taken away.
const { page: other } = await somebody(() => true);
await other.goto(invitation);
await other.getByLabel(/password/i).fill("a long enough password");
await other.getByRole("button", { name: "Create my account" }).click();
await other.waitForURL((url) => url.pathname === "/");
await other.goto(`${address}/missions/${mission}`);
results.before = await other.getByRole("alert").first().innerText();
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
await other.getByRole("alert").first().waitFor(); // by itself: what changed is told
results.revoked = await other.getByRole("alert").first().innerText();

// What people named and said is text, whichever view of the project shows it.
const made = () => page.evaluate(() => document.querySelectorAll("main img, main script, main b, main i, main u, main a[href=x]").length);
results.elements = [await made()];
for (const name of ["Missions", "Statistics", "Metadata fields", "Activity", "Settings"]) {
  const tab = page.getByRole("navigation", { name: "Views of the project" }).getByRole("link", { name });
  await tab.click();
  await tab.and(page.locator("[aria-current=page]")).waitFor();
  await page.waitForFunction(() => document.querySelector("main .skeleton, main [aria-busy=true]") === null);
  results.elements.push(await made());
}
await printResults();
