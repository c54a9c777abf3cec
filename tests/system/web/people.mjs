// What an admin and somebody new do: an invitation is made and accepted, a group is filled and its right is met and lost,
// a token is made and revoked, a mission comes back from the trash, the record tells of it, the power of an admin is given
// and taken, a new password is chosen by a link, somebody leaves and is let back in, a job is tried again.
// Prints as JSON what was seen. Arguments: the folder with playwright-core and axe-core, the browser, a link that signs
// the owner in, the server's address, the id of the project, the number of a job that failed, where pictures go.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, project, job, pictures] = process.argv.slice(2);
const HOSTILE = '<img src=x onerror="globalThis.wasRun = true">';
// A name may not hold what paths and wildcards need.
const HOSTILE_GROUP = "<img src=x onerror=globalThis.wasRun=true>";
const { results, somebody, checkPage: checkReadyPage, printResults } = await openBrowser(web, executablePath, pictures);

/** Looks at what was opened, once it is there. */
async function checkPage(page, name, ready) {
  await ready.first().waitFor();
  await checkReadyPage(page, name);
  if (await page.evaluate(() => globalThis.wasRun === true)) results.ran.push(name);
}

const secretOf = async (page) => (await page.locator("[data-secret] pre").first().innerText()).trim();
const row = (page, text) => page.getByRole("row").filter({ hasText: text });

const { page: owner, context: ownersBrowser } = await somebody();
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
const { page: ben, context: bensBrowser } = await somebody();
await ben.goto(await secretOf(owner));
await owner.getByRole("button", { name: "I saved it" }).click();
await ben.getByLabel("Your name").fill(HOSTILE);
await ben.getByLabel(/password/i).fill("a long enough password");
await ben.getByRole("button", { name: "Create my account" }).click();
await ben.waitForURL((url) => url.pathname === "/");
const asBen = async (path) => (await bensBrowser.request.get(`${address}/api/v1${path}`)).status();

// What is not theirs is not shown, and says so at its address.
await ben.goto(`${address}/admin`);
results.refused = await ben.getByRole("heading", { name: "Admins only" }).innerText();
results.adminLinks = await ben.getByRole("navigation", { name: "Main" }).getByRole("link", { name: "Admin" }).count();
await checkPage(ben, "admin-refused", ben.getByRole("heading", { name: "Admins only" }));

// A group with an end for its member; a right for the group is a right for them.
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
results.before = await asBen(`/projects/${project}`);
const given = { data: { group_id: group, right: "READ" } };
const headers = { Origin: address };
results.given = (await ownersBrowser.request.post(`${address}/api/v1/projects/${project}/grants`, { ...given, headers })).status();
results.during = await asBen(`/projects/${project}`);
await owner.goto(`${address}/people/access`);
await owner.getByLabel("Project").selectOption({ label: "Alps" });
await row(owner, "as a member of").first().waitFor();
results.access = await row(owner, "as a member of").first().innerText();
await row(owner, "as a member of").getByRole("link").first().click();
await row(owner, "Alps").waitFor();
results.reach = await row(owner, "Alps").innerText();
const person = new URL(owner.url()).pathname;
await owner.goto(`${address}/groups/${group}`);
await row(owner, "ben@lab.example").first().waitFor();
await row(owner, "ben@lab.example").getByRole("button", { name: /^Remove/ }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Remove" }).click();
await row(owner, "ben@lab.example").waitFor({ state: "detached" });
results.after = await asBen(`/projects/${project}`);

// A robot's token: made, used, revoked.
await owner.goto(`${address}/tokens`);
await owner.getByRole("button", { name: "New token" }).click();
await owner.getByRole("textbox", { name: /^Name/ }).fill(`anymal ${HOSTILE}`.slice(0, 100));
await owner.getByRole("radio", { name: /^Robot/ }).check();
results.limited = await owner.getByRole("button", { name: "Create token" }).isDisabled();
await owner.getByRole("button", { name: "Add Alps", exact: true }).click();
await owner.getByLabel("Expiry").selectOption({ label: "For 30 days" });
await checkPage(owner, "token-new", owner.getByRole("button", { name: "Create token" }));
await owner.getByRole("button", { name: "Create token" }).click();
await owner.locator("[data-secret]").waitFor();
const token = await secretOf(owner);
results.loginLine = await owner.locator("[data-secret] pre").last().innerText();
const asRobot = async () => (await fetch(`${address}/api/v1/me`, { headers: { Authorization: `Bearer ${token}` } })).status;
await owner.getByRole("button", { name: "I saved it" }).click();
results.robot = await asRobot();
await owner.goto(`${address}/tokens`);
await row(owner, "anymal").first().waitFor();
await row(owner, "anymal").getByRole("button", { name: /^Revoke/ }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Revoke" }).click();
await row(owner, "anymal").waitFor({ state: "detached" });
results.revoked = await asRobot();

// Back from the trash.
await owner.goto(`${address}/trash`);
await row(owner, "ridge").first().waitFor();
results.trashed = await row(owner, "ridge").innerText();
await row(owner, "ridge").getByRole("button", { name: /^Restore/ }).click();
await owner.getByText("ridge restored.").first().waitFor();
await row(owner, "ridge").waitFor({ state: "detached" });

// The record tells all of it, narrowed by the address, and exported as it is narrowed.
await owner.goto(`${address}/audit`);
await row(owner, "restored").first().waitFor();
await owner.getByLabel("Event type").selectOption("token.*");
await owner.waitForURL((url) => url.searchParams.get("operation") === "token.*");
await row(owner, "restored").waitFor({ state: "detached" });
results.recorded = await row(owner, "revoked the token").first().innerText();
const exported = await owner.getByRole("link", { name: "Export as JSON Lines" }).getAttribute("href");
results.lines = (await (await ownersBrowser.request.get(`${address}${exported}`)).text()).trim().split("\n").map((line) => JSON.parse(line).operation);
await row(owner, "created the token").first().getByRole("button").click();
await checkPage(owner, "audit-event", owner.getByRole("dialog").getByRole("table"));
results.changes = await owner.getByRole("dialog").getByRole("table").innerText();

// The power of an admin, given and taken away again. Neither goes by one click.
await owner.goto(`${address}${person}`);
await owner.getByRole("button", { name: "Make admin" }).click();
await checkPage(owner, "person-make-admin", owner.getByRole("dialog"));
await owner.getByRole("dialog").getByRole("button", { name: "Make admin" }).click();
await owner.getByRole("button", { name: "Revoke admin rights" }).waitFor();
results.power = [await asBen("/admin/jobs")];
await ben.goto(`${address}/admin`);
await ben.getByRole("heading", { name: "Stored data" }).waitFor();
await ben.goto("about:blank"); // from here on, their pages would hear that they may not
await owner.getByRole("button", { name: "Revoke admin rights" }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Revoke admin rights" }).click();
await owner.getByRole("button", { name: "Make admin" }).waitFor();
results.power.push(await asBen("/admin/jobs"));

// A new password by a link: the old sessions end, and only the new password is taken.
await owner.getByRole("button", { name: "Reset password" }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Create link" }).click();
await checkPage(owner, "person-reset", owner.locator("[data-secret]"));
const { page: again, context: bensOther } = await somebody(() => true);
await again.goto(await secretOf(owner));
await owner.getByRole("button", { name: "I saved it" }).click();
await owner.getByRole("dialog").waitFor({ state: "detached" });
await again.getByLabel(/password/i).fill("another long password");
await again.getByRole("button", { name: "Set this password" }).click();
const signIn = async (password) => {
  await again.goto(`${address}/sign-in`);
  await again.getByLabel("E-mail address").fill("ben@lab.example");
  await again.getByLabel("Password").fill(password);
  await again.getByRole("button", { name: "Sign in" }).click();
};
const asBenAgain = async () => (await bensOther.request.get(`${address}/api/v1/me`)).status();
await again.waitForURL((url) => url.pathname === "/");
results.reset = [await asBen("/me"), await asBenAgain()];

// Somebody leaves, with what is theirs, and is let back in.
await owner.getByRole("button", { name: "Deactivate" }).click();
await checkPage(owner, "person-deactivate", owner.getByRole("dialog").getByRole("button", { name: "Deactivate" }));
await owner.getByRole("dialog").getByRole("button", { name: "Deactivate" }).click();
await owner.getByRole("button", { name: "Reactivate" }).waitFor();
results.left = await owner.getByText("is deactivated. Revoked:").innerText();
await signIn("another long password");
await again.locator("#message:not([hidden])").waitFor();
results.gone = [await asBenAgain(), await again.locator("#message").innerText()];
await owner.getByRole("button", { name: "Reactivate" }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Reactivate" }).click();
await owner.getByRole("button", { name: "Deactivate" }).waitFor();
await signIn("another long password");
await again.waitForURL((url) => url.pathname === "/");
results.returned = await asBenAgain();

// A job that was given up is tried again.
await owner.goto(`${address}/admin?tab=jobs`);
await owner.getByRole("button", { name: `Retry #${job}` }).click();
await owner.getByText(`Job ${job} is queued again.`).waitFor();
await owner.getByRole("button", { name: `Retry #${job}` }).waitFor({ state: "detached" });
results.failed = await owner.getByText("No failed jobs.").count();
await printResults();
