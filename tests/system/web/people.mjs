// What an admin and somebody new do: an invitation is made and accepted, a group is filled and its right is met and lost,
// a token is made and revoked, a mission comes back from the trash, the record tells of it, somebody leaves.
// Prints as JSON what was seen. Arguments: the folder with playwright-core and axe-core, the browser, a link that signs
// the owner in, the server's address, the id of the project, where pictures go.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [web, executablePath, link, address, project, pictures] = process.argv.slice(2);
const require = createRequire(`${web}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const PATIENCE_MS = 60_000;
const MOST_TRIES = 4;
const HOSTILE = '<img src=x onerror="globalThis.wasRun = true">';
// A name may not hold what paths and wildcards need.
const HOSTILE_GROUP = "<img src=x onerror=globalThis.wasRun=true>";
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
const LOOKS = [["desktop", "light", 1440], ["desktop-dark", "dark", 1440], ["phone", "light", 360], ["phone-dark", "dark", 360]];

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const seen = { complaints: [], axe: [], wide: [], ran: [] };

async function somebody() {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, reducedMotion: "reduce" });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && seen.complaints.push(message.text()));
  page.on("pageerror", (error) => seen.complaints.push(error.message));
  page.on("dialog", (dialog) => seen.ran.push(dialog.message()));
  return { context, page };
}

/** What axe finds once colours and columns have settled: a page that is still being laid out anew is asked again. */
async function settledAxe(page) {
  await page.evaluate(axe);
  let found = { violations: [] };
  for (let tries = 0; tries < MOST_TRIES; tries += 1) {
    await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
    found = await page.evaluate((runOnly) => globalThis.axe.run(document, { runOnly }), RULES);
    if (found.violations.length === 0) break;
  }
  return found;
}

/** Looks at a page in light and dark, wide and narrow; at what opened on one, in half of these. */
async function look(page, name, path, ready) {
  if (path !== null) await page.goto(`${address}${path}`);
  await ready.first().waitFor();
  for (const [kind, colorScheme, width] of path === null ? [LOOKS[0], LOOKS[3]] : LOOKS) {
    await page.emulateMedia({ colorScheme });
    await page.setViewportSize({ width, height: 900 });
    await ready.first().waitFor();
    await page.waitForFunction((theme) => (document.documentElement.dataset.theme ?? "light") === theme, colorScheme);
    const found = await settledAxe(page);
    seen.axe.push(...found.violations.map(({ id, nodes }) => `${name} ${kind}: ${id} ${nodes[0]?.html}`));
    if (await page.evaluate(() => document.documentElement.scrollWidth > document.documentElement.clientWidth)) seen.wide.push(`${name} ${kind}`);
    await page.screenshot({ path: `${pictures}/${name}-${kind}.png`, fullPage: true });
  }
  await page.emulateMedia({ colorScheme: "light" });
  await page.setViewportSize({ width: 1440, height: 900 });
  if (await page.evaluate(() => globalThis.wasRun === true)) seen.ran.push(name);
}

const secretOf = async (page) => (await page.locator("[data-secret] pre").first().innerText()).trim();
const row = (page, text) => page.getByRole("row").filter({ hasText: text });

const { page: owner, context: ownersBrowser } = await somebody();
await owner.goto(link);
await owner.waitForURL((url) => url.pathname === "/");

// An invitation, accepted in another browser.
await owner.goto(`${address}/people`);
await owner.getByRole("button", { name: "Invite somebody" }).click();
await owner.getByLabel("E-mail address").fill("ben@lab.example");
await owner.getByLabel("Name, if you know it").fill(HOSTILE);
await look(owner, "people-invite", null, owner.getByRole("button", { name: "Make the link" }));
await owner.getByRole("button", { name: "Make the link" }).click();
await owner.locator("[data-secret]").waitFor();
const { page: ben, context: bensBrowser } = await somebody();
await ben.goto(await secretOf(owner));
await owner.getByRole("button", { name: "I have kept it" }).click();
await ben.getByLabel("Your name").fill(HOSTILE);
await ben.getByLabel(/password/i).fill("a long enough password");
await ben.getByRole("button", { name: "Make my account" }).click();
await ben.waitForURL((url) => url.pathname === "/");
const asBen = async (path) => (await bensBrowser.request.get(`${address}/api/v1${path}`)).status();

// What is not theirs is not shown, and says so at its address.
await ben.goto(`${address}/admin`);
seen.refused = await ben.getByRole("heading", { name: "This page is for admins" }).innerText();
seen.adminLinks = await ben.getByRole("navigation", { name: "Main" }).getByRole("link", { name: "Admin" }).count();
await look(ben, "admin-refused", null, ben.getByRole("heading", { name: "This page is for admins" }));

// A group with an end for its member; a right for the group is a right for them.
await owner.goto(`${address}/groups`);
await owner.getByRole("button", { name: "New group" }).first().click();
await owner.getByRole("dialog").getByLabel("Name").fill(HOSTILE_GROUP);
await owner.getByRole("dialog").getByRole("button", { name: "Save" }).click();
await owner.waitForURL((url) => url.pathname.startsWith("/groups/"));
const group = new URL(owner.url()).pathname.split("/").at(-1);
await owner.getByRole("button", { name: "Add somebody" }).click();
await owner.getByRole("radio", { name: /ben@lab/ }).check();
await owner.getByLabel("How long").selectOption({ label: "For 90 days" });
await look(owner, "group-add", null, owner.getByRole("radio", { name: /ben@lab/ }));
await owner.getByRole("button", { name: "Add", exact: true }).click();
await row(owner, "ben@lab.example").waitFor();
seen.member = await row(owner, "ben@lab.example").innerText();
seen.before = await asBen(`/projects/${project}`);
const given = { data: { group_id: group, right: "READ" } };
const headers = { Origin: address };
seen.given = (await ownersBrowser.request.post(`${address}/api/v1/projects/${project}/grants`, { ...given, headers })).status();
seen.during = await asBen(`/projects/${project}`);
await owner.goto(`${address}/people/access`);
await owner.getByLabel("Project").selectOption({ label: "Alps" });
await row(owner, "as a member of").first().waitFor();
seen.access = await row(owner, "as a member of").first().innerText();
await look(owner, "people-access", `/people/access?project=${project}`, row(owner, "as a member of"));
await row(owner, "as a member of").getByRole("link").first().click();
await row(owner, "Alps").waitFor();
seen.reach = await row(owner, "Alps").innerText();
await look(owner, "person", new URL(owner.url()).pathname, row(owner, "Alps"));
const person = new URL(owner.url()).pathname;
await look(owner, "group", `/groups/${group}`, row(owner, "ben@lab.example"));
await row(owner, "ben@lab.example").getByRole("button", { name: /^Take out/ }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Take out" }).click();
await row(owner, "ben@lab.example").waitFor({ state: "detached" });
seen.after = await asBen(`/projects/${project}`);

// A robot's token: made, used, revoked.
await owner.goto(`${address}/tokens`);
await owner.getByRole("button", { name: "New token" }).click();
await owner.getByRole("textbox", { name: /^Name/ }).fill(`anymal ${HOSTILE}`.slice(0, 100));
await owner.getByRole("radio", { name: /^Robot/ }).check();
seen.limited = await owner.getByRole("button", { name: "Make token" }).isDisabled();
await owner.getByRole("button", { name: "Add Alps", exact: true }).click();
await owner.getByLabel("How long it holds").selectOption({ label: "For 30 days" });
await look(owner, "token-new", null, owner.getByRole("button", { name: "Make token" }));
await owner.getByRole("button", { name: "Make token" }).click();
await owner.locator("[data-secret]").waitFor();
const token = await secretOf(owner);
seen.loginLine = await owner.locator("[data-secret] pre").last().innerText();
const asRobot = async () => (await fetch(`${address}/api/v1/me`, { headers: { Authorization: `Bearer ${token}` } })).status;
await owner.getByRole("button", { name: "I have kept it" }).click();
seen.robot = await asRobot();
await look(owner, "tokens", "/tokens", row(owner, "anymal"));
await row(owner, "anymal").getByRole("button", { name: /^Revoke/ }).click();
await owner.getByRole("dialog").getByRole("button", { name: "Revoke" }).click();
await row(owner, "anymal").waitFor({ state: "detached" });
seen.revoked = await asRobot();

// Back from the trash.
await look(owner, "trash", "/trash", row(owner, "ridge"));
seen.trashed = await row(owner, "ridge").innerText();
await row(owner, "ridge").getByRole("button", { name: /^Put back/ }).click();
await owner.getByText("ridge is back.").first().waitFor();
await row(owner, "ridge").waitFor({ state: "detached" });

// The record tells all of it, narrowed by the address, and exported as it is narrowed.
await look(owner, "audit", "/audit", row(owner, "put back"));
await owner.getByLabel("Which acts").selectOption("token.*");
await owner.waitForURL((url) => url.searchParams.get("operation") === "token.*");
await row(owner, "put back").waitFor({ state: "detached" });
seen.recorded = await row(owner, "revoked the token").first().innerText();
const exported = await owner.getByRole("link", { name: "Export as JSON lines" }).getAttribute("href");
seen.lines = (await (await ownersBrowser.request.get(`${address}${exported}`)).text()).trim().split("\n").map((line) => JSON.parse(line).operation);
await row(owner, "made the token").first().getByRole("button").click();
await look(owner, "audit-event", null, owner.getByRole("dialog").getByRole("table"));
seen.changes = await owner.getByRole("dialog").getByRole("table").innerText();

// Somebody leaves, with what is theirs. Their page, which would hear of it, is closed before.
await ben.close();
await owner.goto(`${address}${person}`);
await owner.getByRole("button", { name: "Deactivate" }).click();
await look(owner, "person-deactivate", null, owner.getByRole("dialog").getByRole("button", { name: "Deactivate" }));
await owner.getByRole("dialog").getByRole("button", { name: "Deactivate" }).click();
await owner.getByRole("button", { name: "Let back in" }).waitFor();
seen.left = await owner.getByText("is deactivated; ended:").innerText();
seen.gone = await asBen("/me");

await look(owner, "people", "/people", row(owner, "Deactivated"));
await look(owner, "groups", "/groups", owner.getByRole("row").nth(1));
await look(owner, "sessions", "/sessions", owner.getByText("This browser"));
await look(owner, "admin-storage", "/admin", owner.getByRole("heading", { name: "What it keeps" }));
await look(owner, "admin-jobs", "/admin?tab=jobs", owner.getByRole("heading", { name: "The queue" }));
await look(owner, "admin-health", "/admin?tab=health", owner.getByText("Everything that it needs answers."));
await look(owner, "admin-settings", "/admin?tab=settings", owner.getByText("KLEINKRAM_TRASH_DAYS"));
await browser.close();
process.stdout.write(JSON.stringify(seen));
