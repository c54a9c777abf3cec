// A person changes their password and unlinks a provider; the owner creates a mission in a form that shows errors beside
// its fields, reads why a job failed, and starts a scrub. Prints the results as JSON. Arguments: the folder with
// playwright-core and axe-core, the browser, a sign-in link of the owner, the server's address, the email address and the
// password of a person with a provider, the id of a project, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, email, password, project, pictures] = process.argv.slice(2);
const NEW_PASSWORD = "another that is long enough";
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let expectsErrors = false;

/** Waits until a field is invalid, and returns its error. */
async function fieldError(page, label) {
  const field = page.getByRole("dialog").getByLabel(label).first();
  await field.and(page.locator("[aria-invalid='true']")).waitFor();
  const id = (await field.getAttribute("aria-describedby")).split(" ").find((part) => part.endsWith("-error"));
  return page.locator(`[id="${id}"]`).innerText();
}

async function signIn(page, withPassword) {
  await page.goto(`${address}/sign-in?return_to=/account`);
  await page.getByLabel("E-mail address").fill(email);
  await page.getByLabel("Password").fill(withPassword);
  await page.getByRole("button", { name: "Sign in", exact: true }).click();
  await page.waitForURL((url) => url.pathname === "/account");
  await page.getByText("Signed in as Ada").waitFor();
}

// Two sessions: changing the password in one ends the other.
const { page: ada } = await openPage(() => expectsErrors);
const { page: other, context: otherContext } = await openPage(() => true);
await signIn(other, password);
const otherSessionStatus = async () => (await otherContext.request.get(`${address}/api/v1/me`)).status();
await signIn(ada, password);
await ada.getByText("https://gone.example").waitFor();
await checkPage(ada, "account");
results.account = await ada.getByRole("main").innerText();
results.statusBefore = await otherSessionStatus();
await other.close();
await ada.getByRole("button", { name: "Change password" }).click();
const dialog = ada.getByRole("dialog");
await dialog.getByLabel("Current password").fill("not that one");
await dialog.getByLabel("New password").fill("short");
await dialog.getByRole("button", { name: "Change password" }).click();
results.tooShort = await fieldError(ada, "New password");
await dialog.getByLabel("New password").fill(NEW_PASSWORD);
expectsErrors = true;
await dialog.getByRole("button", { name: "Change password" }).click();
results.wrongPassword = await fieldError(ada, "Current password");
expectsErrors = false;
await checkPage(ada, "account-password");
await dialog.getByLabel("Current password").fill(password);
await dialog.getByRole("button", { name: "Change password" }).click();
await ada.getByText("Password changed").first().waitFor();
results.statusAfter = await otherSessionStatus();

// Unlinking a provider; signing in by the new password still works.
await ada.getByRole("button", { name: "Unlink https://gone.example" }).click();
await checkPage(ada, "account-unlink");
await dialog.getByRole("button", { name: "Unlink" }).click();
await ada.getByText("https://gone.example unlinked.").first().waitFor();
await ada.locator("[data-methods] li").nth(1).waitFor({ state: "detached" });
await ada.getByRole("button", { name: "Sign out", exact: true }).click();
await ada.waitForURL((url) => url.pathname === "/sign-in");
await signIn(ada, NEW_PASSWORD);
await ada.getByRole("button", { name: "Sign out everywhere" }).click();
await dialog.getByRole("button", { name: "Sign out everywhere" }).click();
await ada.waitForURL((url) => url.pathname === "/sign-in");
await ada.close();

// The form of a new mission marks values copied from the last mission until they are confirmed, and shows an error beside
// each field: first those that the form finds, then those that the server returns.
const { page: owner, context: ownerContext } = await openPage(() => expectsErrors);
await owner.goto(link);
await owner.waitForURL((url) => url.pathname === "/");
await owner.goto(`${address}/projects/${project}`);
await owner.getByRole("button", { name: "New mission" }).click();
const form = owner.getByRole("dialog");
const createButton = form.getByRole("button", { name: "Create mission" });
await form.getByText("Some values were copied from the mission taken.").waitFor();
results.prefilled = await Promise.all([/^robot/, /^operator/, /^day/].map((name) => form.getByLabel(name).inputValue()));
await createButton.click();
results.unconfirmed = await fieldError(owner, /^robot/);
await checkPage(owner, "mission-new-unconfirmed");
await form.getByLabel(/^robot/).selectOption("");
await createButton.click();
results.nameMissing = await fieldError(owner, /^Name · required/);
results.robotMissing = await fieldError(owner, /^robot/);
await form.getByLabel(/^Name · required/).fill("TAKEN");
await form.getByLabel(/^robot/).selectOption("spot");
await form.getByLabel(/^operator/).fill("1815");
expectsErrors = true;
await createButton.click();
results.operatorWrong = await fieldError(owner, /^operator/);
await checkPage(owner, "mission-new");
await form.getByLabel(/^operator/).fill("Ada");
await createButton.click();
results.nameTaken = await fieldError(owner, /^Name · required/);
expectsErrors = false;
await form.getByLabel(/^Name · required/).fill("ridge");
await createButton.click();
await owner.waitForURL((url) => url.pathname.startsWith("/missions/"));
await owner.getByRole("heading", { name: "ridge" }).waitFor();
results.mission = await owner.locator("[data-metadata]").innerText();

// The error of a failed job.
await owner.goto(`${address}/admin?tab=jobs`);
await owner.getByText("ValueError: badly formed").waitFor();
await checkPage(owner, "admin-jobs-failed");

// A scrub. The owner's sign-in is too old for it, so they sign in again by a link.
await owner.goto(`${address}/admin?tab=scrub`);
await owner.route("**/admin/scrub", (route) => route.request().method() === "POST"
  ? route.fulfill({ status: 403, json: { type: "about:blank", title: "Too long ago", status: 403, code: "sign_in_too_old" } })
  : route.fallback());
const scrub = owner.locator("[data-scrub]");
const bodyOf = (response) => response.json().catch(() => ({})); // the page may have cancelled the request meanwhile
const responseTo = (method, matches) => owner.waitForResponse(async (response) =>
  response.url().endsWith("/admin/scrub") && response.ok() && response.request().method() === method && matches(await bodyOf(response)));
let scrubId = "";
const begun = responseTo("POST", ({ id = "" }) => (scrubId = id) !== "");
const ended = responseTo("GET", ({ last }) => last?.id === scrubId && last.ended_at !== null);
expectsErrors = true;
await scrub.getByRole("button", { name: "Scrub now" }).click();
await owner.getByRole("dialog").getByText("Sign in again").waitFor();
await checkPage(owner, "sign-in-again");
expectsErrors = false;
await owner.unroute("**/admin/scrub");
const { url: ownerLink } = await owner.evaluate(async () => (await fetch("/api/v1/auth/owner-link", { method: "POST" })).json());
const window = await ownerContext.newPage();
await window.goto(ownerLink);
await window.waitForURL((url) => url.pathname === "/");
await Promise.all([begun, ended]);
await owner.getByRole("dialog").waitFor({ state: "detached" });
await window.close();
await scrub.getByText("Done", { exact: true }).waitFor();
results.scrub = await scrub.innerText();
await checkPage(owner, "admin-scrub");
await printResults();
