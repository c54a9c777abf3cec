// Every page there is, wide and on a phone, light and dark, as an admin, as somebody new and as a stranger, in a world of
// hostile names. Prints as JSON what was seen. Arguments: the folder with playwright-core and axe-core, the browser, a
// link that signs in, the server's address, where pictures go, and as JSON: the world and the texts that are to be shown.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { isOfTheMachine } from "./complaints.mjs";

const [web, executablePath, link, address, pictures, input] = process.argv.slice(2);
const { invitation, unused, share, ids, texts, store, every } = JSON.parse(input);
const require = createRequire(`${web}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const PATIENCE_MS = 60_000;
const MOST_TRIES = 4;
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
const WIDE = { width: 1440, height: 900 };
const NARROW = { width: 360, height: 740 };
// Colours follow from the theme and layout from the width: two looks see both of each. Soak sees all four.
const TWO = [["desktop", "light", WIDE], ["phone-dark", "dark", NARROW]];
const LOOKS = every ? [...TWO, ["phone", "light", NARROW], ["desktop-dark", "dark", WIDE]] : TWO;

// What a browser complains of where it was meant to be so: an answer that refuses, a window that it would not close.
const NOTHING = /^$/;
const REFUSED = /^Failed to load resource: the server responded with a status of 4/;
const NOBODY = /^Failed to load resource: the server responded with a status of 401/;
const OPEN = /^Scripts may close only the windows/;
const TALLEST = 2400;

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const results = { complaints: [], violations: [], ran: [], elsewhere: [], axe: [], wide: [], unseen: [], policies: {}, looked: [] };
let at = "";
let meant = NOTHING;

async function somebody() {
  const context = await browser.newContext({ viewport: WIDE, reducedMotion: "reduce" });
  await context.addInitScript(() => {
    globalThis.violations = [];
    document.addEventListener("securitypolicyviolation", ({ violatedDirective, blockedURI }) => globalThis.violations.push(`${violatedDirective} ${blockedURI}`));
  });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  page.on("console", (message) => {
    if (["error", "warning"].includes(message.type()) && !meant.test(message.text()) && !isOfTheMachine(message.text())) results.complaints.push(`${at}: ${message.text()}`);
  });
  page.on("pageerror", (error) => {
    if (!isOfTheMachine(error.message)) results.complaints.push(`${at}: ${error.message}`);
  });
  page.on("dialog", (dialog) => {
    results.ran.push(`${at}: dialog ${dialog.message()}`);
    void dialog.dismiss();
  });
  page.on("request", (request) => {
    const { protocol, origin } = new URL(request.url());
    if (protocol.startsWith("http") && ![address, store].includes(origin)) results.elsewhere.push(`${at}: ${request.url()}`);
  });
  return { context, page };
}

/** Waits until nothing is still coming, and what came has been laid out. */
async function settled(page, colorScheme) {
  await page.waitForFunction((scheme) => {
    const coming = document.querySelector("main .skeleton, main [aria-busy=true], dialog .skeleton");
    const title = document.querySelector("h1")?.textContent?.trim() ?? "";
    const theme = document.documentElement.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    return coming === null && title !== "" && theme === scheme;
  }, colorScheme).catch(async (error) => {
    throw new Error(`${at} does not settle: ${await page.locator("body").innerText()}`, { cause: error });
  });
  await page.evaluate(async () => {
    await document.fonts.ready;
    await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
  });
}

/** What axe finds; a page that is still being laid out anew is asked again. */
async function ask(page) {
  let found = [];
  for (let tries = 0; tries < MOST_TRIES; tries += 1) {
    found = await page.evaluate(async (runOnly) => {
      const { violations } = await globalThis.axe.run(document, { runOnly, resultTypes: ["violations"] });
      return violations.map(({ id, nodes }) => `${id} ${nodes[0]?.html} ${nodes[0]?.failureSummary}`);
    }, RULES);
    if (found.length === 0) break;
    await settled(page, await page.evaluate(() => (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")));
  }
  return found;
}

/** Whether the chosen one of a page's tabs is not to be seen whole. */
function isTabOut() {
  const chosen = document.querySelector("main nav.tabs [aria-current]");
  if (chosen === null) return false;
  const [tab, room] = [chosen, chosen.parentElement].map((each) => each.getBoundingClientRect());
  return tab.left < room.left - 1 || tab.right > room.right + 1;
}

/** What a page says: its text, and what stands in its fields. */
function saidBy(page) {
  return page.evaluate(() => {
    const fields = [...document.querySelectorAll("input, textarea, select")].map((field) => field.selectedOptions?.[0]?.textContent ?? field.value);
    return [document.body.innerText, ...fields].join("\n").replaceAll(/\s+/g, " ");
  });
}

async function checkPage(page, name, { path = null, ready = null, shows = [], allows = NOTHING, whole = true } = {}) {
  at = name;
  meant = allows;
  if (path !== null) {
    const answer = await page.goto(`${address}${path}`);
    if (answer !== null) results.policies[name] = answer.headers()["content-security-policy"] ?? "";
  }
  await page.evaluate(axe);
  if (ready !== null) await page.locator(ready).first().waitFor();
  for (const [kind, colorScheme, size] of LOOKS) {
    await page.emulateMedia({ colorScheme });
    await page.setViewportSize(size);
    await settled(page, colorScheme);
    for (const each of await ask(page)) results.axe.push(`${name} ${kind}: ${each}`);
    const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    if (over > 0) results.wide.push(`${name} ${kind}: ${over} px`);
    if (await page.evaluate(isTabOut)) results.wide.push(`${name} ${kind}: the chosen tab is out of sight`);
    if (whole) {
      const height = await page.evaluate(() => document.documentElement.scrollHeight);
      await page.setViewportSize({ width: size.width, height: Math.min(TALLEST, Math.max(size.height, height)) });
      await settled(page, colorScheme);
    }
    await page.screenshot({ path: `${pictures}/page-${name}-${kind}.png` });
    if (kind === "desktop") {
      const said = await saidBy(page);
      results.unseen.push(...shows.filter((text) => !said.includes(text.replaceAll(/\s+/g, " "))).map((text) => `${name}: ${text}`));
    }
  }
  await page.emulateMedia({ colorScheme: "light" });
  await page.setViewportSize(WIDE);
  const found = await page.evaluate(() => ({ violations: globalThis.violations, wasRun: "wasRun" in globalThis }));
  results.violations.push(...found.violations.map((each) => `${name}: ${each}`));
  if (found.wasRun) results.ran.push(name);
  results.looked.push(name);
}

/** Whether a page runs what somebody could slip in: a script in it, a handler of an element, an address of a script. */
async function runs(context, path) {
  const page = await context.newPage();
  await page.goto(`${address}${path}`);
  const found = await page.evaluate(async () => {
    const script = document.createElement("script");
    script.textContent = "globalThis.inlineRan = true";
    const image = document.createElement("div");
    image.innerHTML = `<img src="data:," onerror="globalThis.inlineRan = true"><a href="javascript:void(globalThis.inlineRan = true)">x</a>`;
    const refused = new Promise((resolve) => {
      let count = 0;
      document.addEventListener("securitypolicyviolation", () => (count += 1) >= 3 && resolve(count));
    });
    document.body.append(script, image);
    image.querySelector("a").click();
    await refused;
    return globalThis.inlineRan === true;
  });
  await page.close();
  return found;
}

// Somebody new: an invitation is accepted, and there is nothing yet.
const { page: eve, context: evesBrowser } = await somebody();
const code = new URL(invitation).hash.slice(1);
const account = { data: { code, name: texts.person, password: "a long enough password" }, headers: { Origin: address } };
results.accepted = (await evesBrowser.request.post(`${address}/api/v1/auth/invitation`, account)).status();
const person = (await (await evesBrowser.request.get(`${address}/api/v1/me`)).json()).person.id;
await checkPage(eve, "new-home", { path: "/", shows: [texts.person] });
await checkPage(eve, "new-projects", { path: "/projects" });
await checkPage(eve, "new-search", { path: "/search" });
await checkPage(eve, "new-upload", { path: "/upload" });
await checkPage(eve, "new-trash", { path: "/trash" });
await checkPage(eve, "new-tokens", { path: "/tokens" });
await checkPage(eve, "new-people", { path: "/people" });
await checkPage(eve, "new-groups", { path: "/groups" });
await checkPage(eve, "new-audit", { path: "/audit", allows: REFUSED });
await checkPage(eve, "new-admin", { path: "/admin", allows: REFUSED });
await checkPage(eve, "refused-mission", { path: `/missions/${ids.mission}`, allows: REFUSED });

// The owner, on every page.
const { page, context } = await somebody();
at = "link";
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
const asOwner = (method, path, data) => context.request[method](`${address}/api/v1${path}`, { data, headers: { Origin: address } });
results.member = (await asOwner("put", `/groups/${ids.group}/members/${person}`, {})).status();
results.granted = (await asOwner("post", `/projects/${ids.project}/grants`, { group_id: ids.group, right: "READ" })).status();
const { project, mission } = texts;
await checkPage(page, "home", { path: "/", shows: [mission] });
await checkPage(page, "projects", { path: "/projects", shows: [project] });
const ofProject = (query) => `/projects/${ids.project}?${query}`;
await checkPage(page, "project", { path: ofProject(""), shows: [project, mission, texts.description] });
await checkPage(page, "project-timeline", { path: ofProject("view=timeline"), shows: [mission] });
await checkPage(page, "project-stats", { path: ofProject("tab=stats") });
await checkPage(page, "project-stats-field", { path: ofProject("tab=stats&by=metadata.robot") });
await checkPage(page, "project-fields", { path: ofProject("tab=fields"), shows: [texts.description] });
await checkPage(page, "project-access", { path: ofProject("tab=access"), shows: [texts.group] });
await checkPage(page, "project-activity", { path: ofProject("tab=activity"), shows: [mission] });
await checkPage(page, "project-settings", { path: ofProject("tab=settings"), shows: [project, texts.description] });
await checkPage(page, "project-empty", { path: `/projects/${ids.empty}` });
const ofMission = (query) => `/missions/${ids.mission}?${query}`;
const facts = [texts.value, texts.address, texts.notes];
await checkPage(page, "mission", { path: ofMission(""), ready: "[data-lanes]", shows: [project, mission, texts.recording, texts.text, texts.label, ...facts] });
results.links = await page.evaluate(() => [...document.links].map((each) => each.protocol).filter((each) => !/^https?:$/.test(each)));
await page.locator("[data-metadata]").getByRole("button", { name: "<b onclick" }).click();
await checkPage(page, "mission-editing", { shows: [texts.description] });
await checkPage(page, "mission-topics", { path: ofMission("tab=topics"), shows: [texts.topic, texts.type] });
await checkPage(page, "mission-problems", { path: ofMission("tab=problems"), shows: [texts.broken] });
await checkPage(page, "mission-access", { path: ofMission("tab=access"), shows: [texts.share, texts.group] });
await checkPage(page, "file-recording", { path: `/files/${ids.recording}`, shows: [texts.recording, texts.topic, texts.type, texts.label] });
await checkPage(page, "file-drive", { path: `/files/${ids.drive}`, ready: "[data-log-time]" });
await checkPage(page, "file-plot", { path: `/files/${ids.drive}?topic=/imu/data`, ready: "[data-plot-viewer][data-messages]" });
await checkPage(page, "file-broken", { path: `/files/${ids.broken}`, shows: [texts.broken] });
await checkPage(page, "file-text", { path: `/files/${ids.text}`, shows: [texts.text] });
await checkPage(page, "mission-runs", { path: ofMission("tab=runs"), shows: [texts.action] });
await checkPage(page, "actions", { path: "/actions", shows: [texts.action, texts.description] });
await checkPage(page, "action", { path: `/actions/${ids.action}`, shows: [texts.action, texts.description, texts.value] });
await checkPage(page, "launch", { path: `/runs/new?action=${ids.action}&mission=${ids.mission}`, ready: "form:has(.chosen):has(fieldset.parameters)", shows: [mission, texts.description] });
await checkPage(page, "runs", { path: "/runs", shows: [texts.action, mission] });
const ofRun = (query) => `/runs/${ids.run}?${query}`;
await checkPage(page, "run", { path: ofRun(""), ready: "[data-log][data-over] .line", shows: [texts.action, mission, texts.notes, texts.value, texts.label] });
for (const part of ["metrics", "artifacts", "inputs", "definition"]) await checkPage(page, `run-${part}`, { path: ofRun(`tab=${part}`) });
await checkPage(page, "run-findings", { path: ofRun("tab=findings"), shows: [texts.value, texts.topic] });
await checkPage(page, "upload", { path: "/upload" });
const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Choose files" }).click()]);
await chooser.setFiles({ name: texts.recording, mimeType: "", buffer: Buffer.from("x") });
await page.getByText("Destination").waitFor();
await page.getByLabel("Project").selectOption({ label: project });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel(/^robot/).waitFor();
await checkPage(page, "upload-form", { shows: [texts.recording, texts.description] });
const searched = { ready: "[data-results]" };
await checkPage(page, "search", { path: "/search", ...searched, shows: [texts.recording, texts.label] });
await checkPage(page, "search-missions", { path: "/search?tab=missions", ...searched, shows: [mission] });
await checkPage(page, "search-topics", { path: "/search?tab=topics", ...searched, shows: [texts.topic, texts.type] });
await checkPage(page, "search-nothing", { path: `/search?q=${encodeURIComponent(`"${texts.label}" nothing`)}`, ...searched });
await checkPage(page, "search-wrong", { path: `/search?q=${encodeURIComponent(`size:${texts.label}`)}`, allows: REFUSED });
await checkPage(page, "people", { path: "/people", shows: [texts.person] });
await checkPage(page, "person", { path: `/people/${person}`, shows: [texts.person, texts.group] });
await checkPage(page, "access", { path: `/people/access?project=${ids.project}`, shows: [texts.person, texts.group, project] });
await checkPage(page, "groups", { path: "/groups", shows: [texts.group] });
await checkPage(page, "group", { path: `/groups/${ids.group}`, shows: [texts.group, texts.person] });
await checkPage(page, "account", { path: "/account" });
await checkPage(page, "tokens", { path: "/tokens", shows: [texts.token] });
await checkPage(page, "sessions", { path: "/sessions" });
await checkPage(page, "audit", { path: "/audit", shows: [project] });
await checkPage(page, "audit-groups", { path: "/audit?operation=group.*", shows: [texts.group] });
await checkPage(page, "trash", { path: "/trash", shows: [texts.gone, project] });
for (const tab of ["storage", "scrub", "jobs", "health", "settings"]) await checkPage(page, `admin-${tab}`, { path: `/admin?tab=${tab}` });
await checkPage(page, "not-found", { path: `/nowhere/${encodeURIComponent(texts.label)}`, allows: REFUSED });
await checkPage(page, "signed-in", { path: "/signed-in", allows: OPEN });

// What opens on pages.
const opened = { whole: false };
await page.goto(`${address}/projects`);
await page.getByRole("button", { name: "New project" }).first().click();
await checkPage(page, "dialog-project", { ...opened, ready: "dialog[open]" });
await page.goto(`${address}${ofMission("")}`);
await page.locator("[data-lanes]").waitFor();
await page.getByRole("button", { name: /^Share/ }).first().click();
await checkPage(page, "dialog-share", { ...opened, ready: "dialog[open]", shows: [mission] });
await page.goto(`${address}/`);
await page.locator("h1").waitFor();
await page.keyboard.press("Control+k");
await checkPage(page, "dialog-palette", { ...opened, ready: "dialog[open]" });
await page.goto(`${address}/`);
await page.locator("h1").waitFor();
await page.keyboard.press("Shift+?");
await checkPage(page, "dialog-keys", { ...opened, ready: "dialog[open]" });

// The server's own pages for somebody who is signed in.
await checkPage(page, "account", { path: "/account" });
await checkPage(page, "device", { path: `/sign-in/device?user_code=${encodeURIComponent(texts.value)}`, shows: [texts.value] });
const asks = new URLSearchParams({ port: "4444", state: texts.value, code_challenge: "x", client: texts.value });
await checkPage(page, "cli", { path: `/sign-in/cli?${asks}`, ready: "#decision:not([hidden])", shows: [texts.value] });

// Somebody without an account.
const nobody = { allows: NOBODY };
const { page: stranger, context: strangers } = await somebody();
await checkPage(stranger, "public", { ...nobody, path: "/public", shows: ["Lakes"] });
await checkPage(stranger, "public-project", { ...nobody, path: `/projects/${ids.public}` });
await checkPage(stranger, "public-mission", { ...nobody, path: `/missions/${ids.publicMission}`, ready: "[data-lanes]" });
await checkPage(stranger, "public-file", { ...nobody, path: `/files/${ids.publicFile}`, ready: "[data-log-time]" });
await checkPage(stranger, "public-search", { ...nobody, ...searched, path: "/search" });
await checkPage(stranger, "sign-in", { path: `/sign-in?return_to=${encodeURIComponent(texts.address)}` });
await checkPage(stranger, "invitation", { path: new URL(unused).pathname + new URL(unused).hash, shows: [texts.person] });
await checkPage(stranger, "reset", { path: "/sign-in/reset#not-a-code", allows: REFUSED });
await checkPage(stranger, "claim", { path: "/sign-in/bootstrap" });
await checkPage(stranger, "link", { path: "/sign-in/link#not-a-code", allows: REFUSED });
await checkPage(stranger, "callback", { path: `/sign-in/callback/${encodeURIComponent("<img src=x>")}?error=${encodeURIComponent(texts.label)}`, allows: REFUSED });
await checkPage(stranger, "share", { path: new URL(share).pathname + new URL(share).hash, ready: "#files tr", shows: [project, mission, texts.recording] });
await stranger.goto("about:blank");
await checkPage(stranger, "share-ended", { path: "/s#not-a-secret", ready: "#message:not([hidden])", allows: REFUSED });

results.inline = {};
for (const path of ["/", "/public", "/sign-in", "/s"]) results.inline[path] = await runs(strangers, path === "/" ? "/search" : path);
await browser.close();
process.stdout.write(JSON.stringify(results));
