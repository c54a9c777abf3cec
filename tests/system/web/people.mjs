// An admin and a new user: creates and accepts an invitation, grants and revokes a right by a group, creates and revokes a
// token, restores a mission from the trash, reads the audit log, appoints and dismisses an admin, resets a password,
// deactivates, reactivates and erases a person, retries a job.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link of the
// owner, the server's address, the id of the project, the number of a failed job, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, project, job, pictures] = process.argv.slice(2);
const HOSTILE = '<img src=x onerror="globalThis.wasRun = true">';
// Names of groups may not contain the characters of paths and wildcards.
const HOSTILE_GROUP = "<img src=x onerror=globalThis.wasRun=true>";
const { results, openPage, checkPage: checkReadyPage, printResults } = await openBrowser(web, executablePath, pictures);

/** Waits for what was opened, then checks the page. */
async function checkPage(page, name, ready) {
  await ready.first().waitFor();
  await checkReadyPage(page, name);
  if (await page.evaluate(() => globalThis.wasRun === true)) results.ran.push(name);
}

const secretOf = async (page) => (await page.locator("[data-secret] pre").first().innerText()).trim();
const row = (page, text) => page.getByRole("row").filter({ hasText: text });

const { page: owner, context: ownerContext } = await openPage();
await owner.goto(link);
await owner.waitForURL((url) => url.pathname === "/");

// An invitation, accepted in another browser.
await owner.goto(`${address}/people`);
await owner.getByRole("button", { name: "Invite a person" }).click();
await owner.getByRole("textbox", { name: /^Email address/ }).fill("ben@lab.example");
await owner.getByLabel("Name (optional)").fill(HOSTILE);
await checkPage(owner, "people-invite", owner.getByRole("button", { name: "Create link" }));
await owner.getByRole("button", { name: "Create link" }).click();
await owner.locator("[data-secret]").waitFor();
const { page: ben, context: benContext } = await openPage();
await ben.goto(await secretOf(owner));
await owner.getByRole("button", { name: "I saved it" }).click();
await ben.getByLabel("Your name").fill(HOSTILE);
await ben.getByLabel(/password/i).fill("a long enough password");
await ben.getByRole("button", { name: "Create my account" }).click();
await ben.waitForURL((url) => url.pathname === "/");
const asBen = async (path) => (await benContext.request.get(`${address}/api/v1${path}`)).status();

// The admin pages have no link for other people, and their address is refused.
await ben.goto(`${address}/admin`);
results.refused = await ben.getByRole("heading", { name: "Admins only" }).innerText();
results.adminLinks = await ben.getByRole("navigation", { name: "Main" }).getByRole("link", { name: "Admin" }).count();
await checkPage(ben, "admin-refused", ben.getByRole("heading", { name: "Admins only" }));

// A group whose membership expires; its members have the rights of the group.
await owner.goto(`${address}/groups`);
await owner.getByRole("button", { name: "New group" }).first().click();
await owner.getByRole("dialog").getByLabel("Name").fill(HOSTILE_GROUP);
await owner.getByRole("dialog").getByRole("button", { name: "Save" }).click();
await owner.waitForURL((url) => url.pathname.startsWith("/groups/"));
const group = new URL(owner.url()).pathname.split("/").at(-1);
await owner.getByRole("button", { name: "Add member" }).click();
await owner.getByRole("radio", { name: /ben@lab/ }).check();
await owner.getByLabel("Expiry").selectOption({ label: "For 90 days" });
await checkPage(owner, "group-add", owner.getByRole("radio", { name: /ben@lab/ }));
await owner.getByRole("button", { name: "Add", exact: true }).click();
await row(owner, "ben@lab.example").waitFor();
results.member = await row(owner, "ben@lab.example").innerText();
results.statusBefore = await asBen(`/projects/${project}`);
const grant = { data: { group_id: group, right: "READ" } };
const headers = { Origin: address };
results.grantStatus = (await ownerContext.request.post(`${address}/api/v1/projects/${project}/grants`, { ...grant, headers })).status();
results.statusDuring = await asBen(`/projects/${project}`);
await owner.goto(`${address}/people/access`);
await owner.getByLabel("Project").selectOption({ label: "Alps" });
await row(owner, "as a member of").first().waitFor();
results.accessRow = await row(owner, "as a member of").first().innerText();
await row(owner, "as a member of").getByRole("link").first().click();
await row(owner, "Alps").waitFor();
results.personRights = await row(owner, "Alps").innerText();
const person = new URL(owner.url()).pathname;
await owner.goto(`${address}/groups/${group}`);
await row(owner, "ben@lab.example").first().waitFor();
await row(owner, "ben@lab.example").getByRole("button", { name: /^Remove/ }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Remove" }).click();
await row(owner, "ben@lab.example").waitFor({ state: "detached" });
results.statusAfter = await asBen(`/projects/${project}`);

// A robot's token is created, used and revoked.
await owner.goto(`${address}/tokens`);
await owner.getByRole("button", { name: "New token" }).click();
await owner.getByRole("textbox", { name: /^Name/ }).fill(`anymal ${HOSTILE}`.slice(0, 100));
await owner.getByRole("radio", { name: /^Robot/ }).check();
results.createDisabled = await owner.getByRole("button", { name: "Create token" }).isDisabled();
await owner.getByRole("button", { name: "Add Alps", exact: true }).click();
await owner.getByLabel("Expiry").selectOption({ label: "For 30 days" });
await checkPage(owner, "token-new", owner.getByRole("button", { name: "Create token" }));
await owner.getByRole("button", { name: "Create token" }).click();
await owner.locator("[data-secret]").waitFor();
const token = await secretOf(owner);
results.loginLine = await owner.locator("[data-secret] pre").last().innerText();
const asRobot = async () => (await fetch(`${address}/api/v1/me`, { headers: { Authorization: `Bearer ${token}` } })).status;
await owner.getByRole("button", { name: "I saved it" }).click();
results.robotStatus = await asRobot();
await owner.goto(`${address}/tokens`);
await row(owner, "anymal").first().waitFor();
await row(owner, "anymal").getByRole("button", { name: /^Revoke/ }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Revoke" }).click();
await row(owner, "anymal").waitFor({ state: "detached" });
results.revokedStatus = await asRobot();

// Restores a mission from the trash.
await owner.goto(`${address}/trash`);
await row(owner, "ridge").first().waitFor();
results.trashRow = await row(owner, "ridge").innerText();
await row(owner, "ridge").getByRole("button", { name: /^Restore/ }).click();
await owner.getByText("ridge restored.").first().waitFor();
await row(owner, "ridge").waitFor({ state: "detached" });

// The audit log lists all events, is filtered by the URL, and is exported with the same filter.
await owner.goto(`${address}/audit`);
await row(owner, "restored").first().waitFor();
await owner.getByLabel("Event type").selectOption("token.*");
await owner.waitForURL((url) => url.searchParams.get("operation") === "token.*");
await row(owner, "restored").waitFor({ state: "detached" });
results.auditRow = await row(owner, "revoked the token").first().innerText();
const exported = await owner.getByRole("link", { name: "Export as JSON Lines" }).getAttribute("href");
results.exportedOperations = (await (await ownerContext.request.get(`${address}${exported}`)).text()).trim().split("\n").map((line) => JSON.parse(line).operation);
await row(owner, "created the token").first().getByRole("button").click();
await checkPage(owner, "audit-event", owner.getByRole("dialog").getByRole("table"));
results.changes = await owner.getByRole("dialog").getByRole("table").innerText();

// Admin rights are granted and revoked; both ask for confirmation.
await owner.goto(`${address}${person}`);
await owner.getByRole("button", { name: "Make admin" }).click();
await checkPage(owner, "person-make-admin", owner.getByRole("dialog"));
await owner.getByRole("dialog").getByRole("button", { name: "Make admin" }).click();
await owner.getByRole("button", { name: "Revoke admin rights" }).waitFor();
results.adminStatuses = [await asBen("/admin/jobs")];
await ben.goto(`${address}/admin`);
await ben.getByRole("heading", { name: "Stored data" }).waitFor();
await ben.goto("about:blank"); // an open admin page would log refused requests
await owner.getByRole("button", { name: "Revoke admin rights" }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Revoke admin rights" }).click();
await owner.getByRole("button", { name: "Make admin" }).waitFor();
results.adminStatuses.push(await asBen("/admin/jobs"));

// A password is reset by a link: sessions end, and only the new password is valid.
await owner.getByRole("button", { name: "Reset password" }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Create link" }).click();
await checkPage(owner, "person-reset", owner.locator("[data-secret]"));
const { page: ben2, context: ben2Context } = await openPage(() => true);
await ben2.goto(await secretOf(owner));
await owner.getByRole("button", { name: "I saved it" }).click();
await owner.getByRole("dialog").waitFor({ state: "detached" });
await ben2.getByLabel(/password/i).fill("another long password");
await ben2.getByRole("button", { name: "Set this password" }).click();
const signIn = async (password) => {
  await ben2.goto(`${address}/sign-in`);
  await ben2.getByLabel("E-mail address").fill("ben@lab.example");
  await ben2.getByLabel("Password").fill(password);
  await ben2.getByRole("button", { name: "Sign in" }).click();
};
const newSessionStatus = async () => (await ben2Context.request.get(`${address}/api/v1/me`)).status();
await ben2.waitForURL((url) => url.pathname === "/");
results.resetStatuses = [await asBen("/me"), await newSessionStatus()];

// A person is deactivated, and reactivated.
await owner.getByRole("button", { name: "Deactivate" }).click();
await checkPage(owner, "person-deactivate", owner.getByRole("dialog").getByRole("button", { name: "Deactivate" }));
await owner.getByRole("dialog").getByRole("button", { name: "Deactivate" }).click();
await owner.getByRole("button", { name: "Reactivate" }).waitFor();
results.deactivation = await owner.getByText("is deactivated. Revoked:").innerText();
await signIn("another long password");
await ben2.locator("#message:not([hidden])").waitFor();
results.deactivated = [await newSessionStatus(), await ben2.locator("#message").innerText()];
await owner.getByRole("button", { name: "Reactivate" }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Reactivate" }).click();
await owner.getByRole("button", { name: "Deactivate" }).waitFor();
await signIn("another long password");
await ben2.waitForURL((url) => url.pathname === "/");
results.reactivatedStatus = await newSessionStatus();

// A person is erased, once their name is typed.
await owner.getByRole("button", { name: "Erase" }).click();
const erasing = owner.getByRole("dialog");
await checkPage(owner, "person-erase", erasing.getByRole("button", { name: "Erase" }));
results.eraseDisabled = await erasing.getByRole("button", { name: "Erase" }).isDisabled();
await erasing.getByRole("textbox").fill(HOSTILE);
await erasing.getByRole("button", { name: "Erase" }).click();
results.erasure = await owner.getByText("The person is erased").first().innerText();
await owner.getByRole("heading", { name: /^erased person/ }).waitFor();
results.erasedStatus = await newSessionStatus();
results.eraseButtons = await owner.getByRole("button", { name: "Erase" }).count();

// A failed job is retried.
await owner.goto(`${address}/admin?tab=jobs`);
await owner.getByRole("button", { name: `Retry #${job}` }).click();
await owner.getByText(`Job ${job} is queued again.`).waitFor();
await owner.getByRole("button", { name: `Retry #${job}` }).waitFor({ state: "detached" });
results.noFailedJobs = await owner.getByText("No failed jobs.").count();
await printResults();
