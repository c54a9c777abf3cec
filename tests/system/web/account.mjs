// One's own account and forms: a password is changed, a provider unlinked, a mission made whose form says what is refused,
// and an admin reads why a job failed and has the store scrubbed. Prints as JSON what was seen. Arguments: the folder with playwright-core and
// axe-core, the browser, a link that signs the owner in, the server's address, the address and the password of somebody
// with a provider, the id of a project, where pictures go.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, email, password, project, pictures] = process.argv.slice(2);
const NEW_PASSWORD = "another that is long enough";
const { results, somebody, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let mayRefuse = false;

/** What stands beside a field as wrong with it. */
async function wrongWith(page, label) {
  const field = page.getByRole("dialog").getByLabel(label).first();
  await field.and(page.locator("[aria-invalid='true']")).waitFor();
  const id = (await field.getAttribute("aria-describedby")).split(" ").find((each) => each.endsWith("-error"));
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

// Signed in twice; a password is changed in the one, which ends the other.
const { page: ada } = await somebody(() => mayRefuse);
const { page: other, context: elsewhere } = await somebody(() => true);
await signIn(other, password);
const asOther = async () => (await elsewhere.request.get(`${address}/api/v1/me`)).status();
await signIn(ada, password);
await ada.getByText("https://gone.example").waitFor();
await checkPage(ada, "account");
results.account = await ada.getByRole("main").innerText();
results.before = await asOther();
await other.close();
await ada.getByRole("button", { name: "Change password" }).click();
const dialog = ada.getByRole("dialog");
await dialog.getByLabel("Current password").fill("not that one");
await dialog.getByLabel("New password").fill("short");
await dialog.getByRole("button", { name: "Change password" }).click();
results.tooShort = await wrongWith(ada, "New password");
await dialog.getByLabel("New password").fill(NEW_PASSWORD);
mayRefuse = true;
await dialog.getByRole("button", { name: "Change password" }).click();
results.wrongPassword = await wrongWith(ada, "Current password");
mayRefuse = false;
await checkPage(ada, "account-password");
await dialog.getByLabel("Current password").fill(password);
await dialog.getByRole("button", { name: "Change password" }).click();
await ada.getByText("Password changed").first().waitFor();
results.after = await asOther();

// A provider is unlinked; the account stays open to the new password.
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

// A mission, whose form marks what the last one said until it is confirmed, and says beside each field what is wrong with it: by itself,
// then by the server's word.
const { page: owner, context: ofOwner } = await somebody(() => mayRefuse);
await owner.goto(link);
await owner.waitForURL((url) => url.pathname === "/");
await owner.goto(`${address}/projects/${project}`);
await owner.getByRole("button", { name: "New mission" }).click();
const form = owner.getByRole("dialog");
const make = form.getByRole("button", { name: "Create mission" });
await form.getByText("Some values were copied from the mission taken.").waitFor();
results.prefilled = await Promise.all([/^robot/, /^operator/, /^day/].map((name) => form.getByLabel(name).inputValue()));
await make.click();
results.unconfirmed = await wrongWith(owner, /^robot/);
await checkPage(owner, "mission-new-unconfirmed");
await form.getByLabel(/^robot/).selectOption("");
await make.click();
results.nameMissing = await wrongWith(owner, /^Name · required/);
results.robotMissing = await wrongWith(owner, /^robot/);
await form.getByLabel(/^Name · required/).fill("TAKEN");
await form.getByLabel(/^robot/).selectOption("spot");
await form.getByLabel(/^operator/).fill("1815");
mayRefuse = true;
await make.click();
results.operatorWrong = await wrongWith(owner, /^operator/);
await checkPage(owner, "mission-new");
await form.getByLabel(/^operator/).fill("Ada");
await make.click();
results.nameTaken = await wrongWith(owner, /^Name · required/);
mayRefuse = false;
await form.getByLabel(/^Name · required/).fill("ridge");
await make.click();
await owner.waitForURL((url) => url.pathname.startsWith("/missions/"));
await owner.getByRole("heading", { name: "ridge" }).waitFor();
results.mission = await owner.locator("[data-metadata]").innerText();

// Why a job failed.
await owner.goto(`${address}/admin?tab=jobs`);
await owner.getByText("ValueError: badly formed").waitFor();
await checkPage(owner, "admin-jobs-failed");

// Whether the store still has all. The owner of this machine signed in too long ago for it, and does so again by a link.
await owner.goto(`${address}/admin?tab=scrub`);
await owner.route("**/admin/scrub", (route) => route.request().method() === "POST"
  ? route.fulfill({ status: 403, json: { type: "about:blank", title: "Too long ago", status: 403, code: "sign_in_too_old" } })
  : route.fallback());
const scrub = owner.locator("[data-scrub]");
const responseTo = (method, holds) => owner.waitForResponse(async (answer) =>
  answer.url().endsWith("/admin/scrub") && answer.ok() && answer.request().method() === method && holds(await answer.json()));
let asked = "";
const begun = responseTo("POST", ({ id }) => (asked = id) !== "");
const ended = responseTo("GET", ({ last }) => last?.id === asked && last.ended_at !== null);
mayRefuse = true;
await scrub.getByRole("button", { name: "Scrub now" }).click();
await owner.getByRole("dialog").getByText("Sign in again").waitFor();
await checkPage(owner, "sign-in-again");
mayRefuse = false;
await owner.unroute("**/admin/scrub");
const { url: another } = await owner.evaluate(async () => (await fetch("/api/v1/auth/owner-link", { method: "POST" })).json());
const window = await ofOwner.newPage();
await window.goto(another);
await window.waitForURL((url) => url.pathname === "/");
await Promise.all([begun, ended]);
await owner.getByRole("dialog").waitFor({ state: "detached" });
await window.close();
await scrub.getByText("Done", { exact: true }).waitFor();
results.scrub = await scrub.innerText();
await checkPage(owner, "admin-scrub");
await printResults();
