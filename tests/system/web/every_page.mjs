// Checks every page on desktop or phone, light or dark, as an admin, as a new user and as an anonymous visitor, on a
// server whose objects have hostile names. Prints the results as JSON. Arguments: the folder with playwright-core and
// axe-core, the browser, a sign-in link, the server's address, the folder for screenshots, and as JSON: the ids of the
// objects, the texts that pages must show, and whether to check each page in all views.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { launchBrowser } from "./chromium.mjs";
import { isEnvironmentError } from "./console_errors.mjs";

const [web, executablePath, link, address, pictures, input] = process.argv.slice(2);
const { invitation, unused, share, ids, texts, store, allViews } = JSON.parse(input);
const require = createRequire(`${web}/package.json`);
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const TIMEOUT_MS = 60_000;
const MAX_TRIES = 4;
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
const DESKTOP = { width: 1440, height: 900 };
const PHONE = { width: 360, height: 740 };
// Colours depend only on the theme and layout only on the width, so two views cover both of each. Soak uses all four.
const DEFAULT_VIEWS = [["desktop", "light", DESKTOP], ["phone-dark", "dark", PHONE]];
const ALL_VIEWS = [...DEFAULT_VIEWS, ["phone", "light", PHONE], ["desktop-dark", "dark", DESKTOP]];

// Console errors that a page may cause: a response that refuses, a window that the browser does not close.
const NO_ERRORS = /^$/;
const CLIENT_ERROR = /^Failed to load resource: the server responded with a status of 4/;
const UNAUTHORIZED = /^Failed to load resource: the server responded with a status of 401/;
const WINDOW_NOT_CLOSED = /^Scripts may close only the windows/;
// Pictures are for people; no check reads them.
const WITH_PICTURES = process.env.KLEINKRAM_TEST_PICTURES === "1";
const MAX_HEIGHT = 2400;

const browser = await launchBrowser(web, executablePath);
const results = { consoleErrors: [], cspViolations: [], executed: [], foreignRequests: [], axe: [], overflowing: [], missingTexts: [], policies: {}, visitedPages: [] };
let currentPage = "";
const contents = new Map(); // of a tab: the name of the page that it shows, and the console errors that this page may cause
const phoneTabs = new Map(); // by the tab for the desktop

async function openTab(context) {
  const tab = await context.newPage();
  const content = { name: "", allowedErrors: NO_ERRORS };
  contents.set(tab, content);
  tab.setDefaultTimeout(TIMEOUT_MS);
  tab.on("console", (message) => {
    if (["error", "warning"].includes(message.type()) && !content.allowedErrors.test(message.text()) && !isEnvironmentError(message.text())) results.consoleErrors.push(`${content.name}: ${message.text()}`);
  });
  tab.on("pageerror", (error) => {
    if (!isEnvironmentError(error.message)) results.consoleErrors.push(`${content.name}: ${error.message}`);
  });
  tab.on("dialog", (dialog) => {
    results.executed.push(`${content.name}: dialog ${dialog.message()}`);
    void dialog.dismiss();
  });
  tab.on("request", (request) => {
    const { protocol, origin } = new URL(request.url());
    if (protocol.startsWith("http") && ![address, store].includes(origin)) results.foreignRequests.push(`${content.name}: ${request.url()}`);
  });
  return tab;
}

async function openPage() {
  const context = await browser.newContext({ viewport: DESKTOP, reducedMotion: "reduce" });
  await context.addInitScript(() => {
    globalThis.violations = [];
    document.addEventListener("securitypolicyviolation", ({ violatedDirective, blockedURI }) => globalThis.violations.push(`${violatedDirective} ${blockedURI}`));
  });
  return { context, page: await openTab(context) };
}

/** Changes theme and size at once: the page takes long to compute a new layout for each. */
async function setView(page, colorScheme, size) {
  await Promise.all([page.emulateMedia({ colorScheme }), page.setViewportSize(size)]);
}

/** Returns the second tab of a visitor. It stays a phone: to change the size and the theme takes as long as to load a page. */
async function phoneTabOf(page) {
  if (!phoneTabs.has(page)) {
    const tab = await openTab(page.context());
    await setView(tab, "dark", PHONE);
    phoneTabs.set(page, tab);
  }
  return phoneTabs.get(page);
}

/** Waits until no part of the page is loading, and the layout is final. */
async function waitUntilSettled(page, colorScheme) {
  await page.waitForFunction((scheme) => {
    const pending = document.querySelector("main .skeleton, main [aria-busy=true], dialog .skeleton");
    const title = document.querySelector("h1")?.textContent?.trim() ?? "";
    const theme = document.documentElement.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    return pending === null && title !== "" && theme === scheme;
  }, colorScheme).catch(async (error) => {
    throw new Error(`${currentPage} does not settle: ${await page.locator("body").innerText()}`, { cause: error });
  });
  await page.evaluate(async () => {
    await document.fonts.ready;
    await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
  });
}

/** Returns the violations that axe reports. Repeats the check, because the layout may still be changing. */
async function runAxe(page) {
  let violations = [];
  for (let tries = 0; tries < MAX_TRIES; tries += 1) {
    violations = await page.evaluate(async (runOnly) => {
      const result = await globalThis.axe.run(document, { runOnly, resultTypes: ["violations"], preload: false });
      return result.violations.map(({ id, nodes }) => `${id} ${nodes[0]?.html} ${nodes[0]?.failureSummary}`);
    }, RULES);
    if (violations.length === 0) break;
    await waitUntilSettled(page, await page.evaluate(() => (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")));
  }
  return violations;
}

/** Returns whether the current tab of a page is not completely visible. */
function isCurrentTabCutOff() {
  const current = document.querySelector("main nav.tabs [aria-current]");
  if (current === null) return false;
  const [tab, bar] = [current, current.parentElement].map((element) => element.getBoundingClientRect());
  return tab.left < bar.left - 1 || tab.right > bar.right + 1;
}

/** Returns the text of a page, including the values of its form fields. */
function pageText(page) {
  return page.evaluate(() => {
    const fields = [...document.querySelectorAll("input, textarea, select")].map((field) => field.selectedOptions?.[0]?.textContent ?? field.value);
    return [document.body.innerText, ...fields].join("\n").replaceAll(/\s+/g, " ");
  });
}

/** Returns the texts that a page does not show. Repeats the check, because rows that came in sight may not be rendered yet. */
async function findMissingTexts(page, expectedTexts, colorScheme) {
  let missing = [];
  for (let tries = 0; tries < MAX_TRIES; tries += 1) {
    const shownText = await pageText(page);
    missing = expectedTexts.filter((text) => !shownText.includes(text.replaceAll(/\s+/g, " ")));
    if (missing.length === 0) break;
    await waitUntilSettled(page, colorScheme);
  }
  return missing;
}

// By kind, which is the first word of the name: the number of its pages checked so far, plus the number of the kind.
const viewNumbers = new Map();

/**
 * Returns the views of a page: all of them, or one. The pages of a kind, such as those of a mission or dialogs, take turns
 * between the two default views, and so do the first pages of kinds: each view gets each kind that has several pages,
 * and half of the others.
 */
function chooseViews(name) {
  if (allViews) return ALL_VIEWS;
  if (WITH_PICTURES) return DEFAULT_VIEWS;
  const [kind] = name.split("-");
  const number = viewNumbers.get(kind) ?? viewNumbers.size;
  viewNumbers.set(kind, number + 1);
  return [DEFAULT_VIEWS[number % DEFAULT_VIEWS.length]];
}

/** Makes the viewport as high as the page: lists render the rows in sight only. */
async function showFullPage(page, { width, height }, colorScheme) {
  const fullHeight = await page.evaluate(() => document.documentElement.scrollHeight);
  await page.setViewportSize({ width, height: Math.min(MAX_HEIGHT, Math.max(height, fullHeight)) });
  await waitUntilSettled(page, colorScheme);
}

async function checkView(page, name, [view, colorScheme, size], fullPage) {
  await setView(page, colorScheme, size);
  await waitUntilSettled(page, colorScheme);
  for (const violation of await runAxe(page)) results.axe.push(`${name} ${view}: ${violation}`);
  const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  if (over > 0) results.overflowing.push(`${name} ${view}: ${over} px`);
  if (await page.evaluate(isCurrentTabCutOff)) results.overflowing.push(`${name} ${view}: the current tab is not completely visible`);
  if (!WITH_PICTURES) return;
  if (fullPage) await showFullPage(page, size, colorScheme);
  await page.screenshot({ path: `${pictures}/page-${name}-${view}.png` });
}

async function open(tab, name, path) {
  const answer = await tab.goto(`${address}${path}`);
  if (answer !== null) results.policies[name] = answer.headers()["content-security-policy"] ?? "";
}

async function checkTexts(page, name, expectedTexts, fullPage) {
  await waitUntilSettled(page, "light");
  if (fullPage) await showFullPage(page, DESKTOP, "light");
  results.missingTexts.push(...(await findMissingTexts(page, expectedTexts, "light")).map((text) => `${name}: ${text}`));
  await page.setViewportSize(DESKTOP);
}

/**
 * Checks a page in its views, and its texts on the desktop. `page` is the tab for the desktop; it shows the page afterwards
 * if `path` is null, or if there are texts to expect.
 */
async function checkPage(page, name, { path = null, ready = null, expectedTexts = [], allowedErrors = NO_ERRORS, fullPage = true } = {}) {
  currentPage = name;
  const views = chooseViews(name);
  const isOnPhone = path !== null && views.every(([, , size]) => size === PHONE);
  const tab = isOnPhone ? await phoneTabOf(page) : page;
  const usedTabs = isOnPhone && expectedTexts.length > 0 ? [tab, page] : [tab];
  for (const used of usedTabs) {
    Object.assign(contents.get(used), { name, allowedErrors });
    if (path !== null) await open(used, name, path);
    if (ready !== null) await used.locator(ready).first().waitFor();
  }
  if (!(await tab.evaluate(() => "axe" in globalThis))) await tab.evaluate(axe);
  for (const view of views) await checkView(tab, name, view, fullPage);
  if (tab === page) await setView(page, "light", DESKTOP);
  if (expectedTexts.length > 0) await checkTexts(page, name, expectedTexts, fullPage);
  for (const used of usedTabs) {
    const state = await used.evaluate(() => ({ violations: globalThis.violations.splice(0), wasRun: "wasRun" in globalThis }));
    results.cspViolations.push(...state.violations.map((violation) => `${name}: ${violation}`));
    if (state.wasRun) results.executed.push(name);
  }
  results.visitedPages.push(name);
}

/** Returns whether a page executes injected code: an inline script, an event handler, a `javascript:` URL. */
async function executesInlineScripts(context, path) {
  const page = await context.newPage();
  await page.goto(`${address}${path}`);
  const wasExecuted = await page.evaluate(async () => {
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
  return wasExecuted;
}

const dialogOnly = { fullPage: false };

// A new user accepts an invitation, and has access to nothing yet.
const { page: eve, context: eveContext } = await openPage();
const code = new URL(invitation).hash.slice(1);
const account = { data: { code, name: texts.person, password: "a long enough password" }, headers: { Origin: address } };
results.accepted = (await eveContext.request.post(`${address}/api/v1/auth/invitation`, account)).status();
const person = (await (await eveContext.request.get(`${address}/api/v1/me`)).json()).person.id;
await checkPage(eve, "new-home", { path: "/", expectedTexts: [texts.person] });
await checkPage(eve, "new-projects", { path: "/projects" });
await checkPage(eve, "new-search", { path: "/search" });
await checkPage(eve, "new-upload", { path: "/upload" });
await checkPage(eve, "new-metrics", { path: "/run-metrics" });
await checkPage(eve, "new-trash", { path: "/trash" });
await checkPage(eve, "new-tokens", { path: "/tokens" });
await checkPage(eve, "new-people", { path: "/people" });
await checkPage(eve, "new-groups", { path: "/groups" });
await checkPage(eve, "new-audit", { path: "/audit", allowedErrors: CLIENT_ERROR });
await checkPage(eve, "new-admin", { path: "/admin", allowedErrors: CLIENT_ERROR });
await checkPage(eve, "refused-mission", { path: `/missions/${ids.mission}`, allowedErrors: CLIENT_ERROR });

// The owner sees every page.
const { page, context } = await openPage();
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
const asOwner = (method, path, data) => context.request[method](`${address}/api/v1${path}`, { data, headers: { Origin: address } });
results.member = (await asOwner("put", `/groups/${ids.group}/members/${person}`, {})).status();
results.granted = (await asOwner("post", `/projects/${ids.project}/grants`, { group_id: ids.group, right: "READ" })).status();
const { project, mission } = texts;
await checkPage(page, "home", { path: "/", expectedTexts: [mission] });
await checkPage(page, "projects", { path: "/projects", expectedTexts: [project] });
const ofProject = (query) => `/projects/${ids.project}?${query}`;
await checkPage(page, "project", { path: ofProject(""), expectedTexts: [project, mission, texts.description] });
await checkPage(page, "project-timeline", { path: ofProject("view=timeline"), expectedTexts: [mission] });
await checkPage(page, "project-stats", { path: ofProject("tab=stats") });
await checkPage(page, "project-stats-field", { path: ofProject("tab=stats&by=metadata.robot") });
await checkPage(page, "project-fields", { path: ofProject("tab=fields"), expectedTexts: [texts.description] });
await checkPage(page, "project-access", { path: ofProject("tab=access"), expectedTexts: [texts.group] });
await checkPage(page, "project-activity", { path: ofProject("tab=activity"), expectedTexts: [mission] });
await checkPage(page, "project-settings", { path: ofProject("tab=settings"), expectedTexts: [project, texts.description] });
await checkPage(page, "project-empty", { path: `/projects/${ids.empty}` });
await checkPage(page, "project-empty-checks", { path: `/projects/${ids.empty}?tab=checks` });
await checkPage(page, "project-checks", { path: ofProject("tab=checks"), ready: "[data-matrix] [data-status=error]", expectedTexts: [mission] });
await page.getByRole("gridcell", { name: "topic.gap: Error" }).focus();
await page.locator("[data-explained]").getByText(texts.topic).waitFor();
await checkPage(page, "project-checks-cell", { expectedTexts: [texts.topic] });
await checkPage(page, "project-rules", { path: ofProject("tab=checks&part=rules"), ready: "[data-rules]", expectedTexts: [texts.notes, texts.profile] });
await page.locator("[data-versions]").getByText("Version 1").click();
await page.locator("[data-diff] .added").first().waitFor();
await checkPage(page, "project-rules-version");
await checkPage(page, "project-actions", { path: ofProject("tab=checks&part=actions"), ready: "[data-project-actions]", expectedTexts: [texts.action, texts.value.slice(0, 60)] });
const ofMission = (query) => `/missions/${ids.mission}?${query}`;
const facts = [texts.value, texts.address, texts.notes];
await checkPage(page, "mission", { path: ofMission(""), ready: "[data-lanes]", expectedTexts: [project, mission, texts.recording, texts.text, texts.label, ...facts] });
results.links = await page.evaluate(() => [...document.links].map((each) => each.protocol).filter((each) => !/^https?:$/.test(each)));
await page.locator("[data-metadata]").getByRole("button", { name: "<b onclick" }).click();
await checkPage(page, "mission-editing", { expectedTexts: [texts.description] });
await checkPage(page, "mission-topics", { path: ofMission("tab=topics"), expectedTexts: [texts.topic, texts.type] });
await checkPage(page, "mission-checks", { path: ofMission("tab=checks"), ready: "[data-checks] [role=row][data-index]", expectedTexts: [texts.topic, texts.value, texts.action, texts.profile, texts.reason, `left out ${texts.label}`] });
for (const [check, shown] of [["file.size", [texts.recording, texts.reason]], ["topic.gap", [texts.topic, texts.notes]], ["evil.check", [texts.value, texts.action]]]) {
  await page.goto(`${address}${ofMission(`tab=checks&q=${check}`)}`);
  await page.locator("[data-checks] [data-row-link]", { hasText: check }).first().click();
  await checkPage(page, `dialog-${check.replace(".", "-")}`, { ...dialogOnly, ready: "dialog[open]", expectedTexts: shown });
}
await checkPage(page, "mission-problems", { path: ofMission("tab=problems"), expectedTexts: [texts.broken] });
await checkPage(page, "mission-access", { path: ofMission("tab=access"), expectedTexts: [texts.share, texts.group] });
await checkPage(page, "file-recording", { path: `/files/${ids.recording}`, expectedTexts: [texts.recording, texts.topic, texts.type, texts.label] });
await checkPage(page, "file-drive", { path: `/files/${ids.drive}`, ready: "[data-log-time]" });
await checkPage(page, "file-plot", { path: `/files/${ids.drive}?topic=/imu/data`, ready: "[data-plot-viewer][data-messages]" });
await checkPage(page, "file-view", { path: `/files/${ids.drive}/view`, ready: "[data-plot][data-messages]" });
await checkPage(page, "mission-view", { path: `/missions/${ids.mission}/view`, ready: "[data-panel]" });
await checkPage(page, "file-broken", { path: `/files/${ids.broken}`, expectedTexts: [texts.broken] });
await checkPage(page, "file-text", { path: `/files/${ids.text}`, expectedTexts: [texts.text] });
await checkPage(page, "mission-runs", { path: ofMission("tab=runs"), expectedTexts: [texts.action] });
await checkPage(page, "actions", { path: "/actions", expectedTexts: [texts.action, texts.description] });
await checkPage(page, "action", { path: `/actions/${ids.action}`, expectedTexts: [texts.action, texts.description, texts.value] });
await checkPage(page, "launch", { path: `/runs/new?action=${ids.action}&mission=${ids.mission}`, ready: "form:has(.chosen):has(fieldset.parameters)", expectedTexts: [mission, texts.description] });
await checkPage(page, "runs", { path: "/runs", expectedTexts: [texts.action, mission] });
const ofRun = (query) => `/runs/${ids.run}?${query}`;
await checkPage(page, "run", { path: ofRun(""), ready: "[data-log][data-over] .line", expectedTexts: [texts.action, mission, texts.notes, texts.value, texts.label] });
for (const part of ["artifacts", "inputs", "definition"]) await checkPage(page, `run-${part}`, { path: ofRun(`tab=${part}`) });
await checkPage(page, "run-findings", { path: ofRun("tab=findings"), expectedTexts: [texts.value, texts.topic] });
await checkPage(page, "run-metrics", { path: ofRun("tab=metrics"), ready: "[role=row][data-index]", expectedTexts: [texts.topic, texts.label] });
await checkPage(page, "run-checks", { path: ofRun("tab=checks"), ready: "[role=row][data-index]", expectedTexts: [texts.value, texts.topic] });
const tableQuery = new URLSearchParams([["metric", "evil"], ["project", ids.project], ...["action", "topic", "label.method"].map((name) => ["columns", name])]);
await checkPage(page, "metrics", { path: `/run-metrics?${tableQuery}`, ready: "[data-metrics] [data-index]", expectedTexts: [mission, texts.topic, texts.label, "<b>m"] });
await checkPage(page, "metrics-nothing", { path: "/run-metrics" });
await checkPage(page, "upload", { path: "/upload" });
await page.goto(`${address}/upload`);
const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Choose files" }).click()]);
await chooser.setFiles({ name: texts.recording, mimeType: "", buffer: Buffer.from("x") });
await page.getByText("Destination").waitFor();
await page.getByLabel("Project").selectOption({ label: project });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel(/^robot/).waitFor();
await checkPage(page, "upload-form", { expectedTexts: [texts.recording, texts.description] });
const loadedResults = { ready: "[data-results]" };
await checkPage(page, "search", { path: "/search", ...loadedResults, expectedTexts: [texts.recording, texts.label] });
await checkPage(page, "search-missions", { path: "/search?tab=missions", ...loadedResults, expectedTexts: [mission] });
await checkPage(page, "search-topics", { path: "/search?tab=topics", ...loadedResults, expectedTexts: [texts.topic, texts.type] });
await checkPage(page, "search-map", { path: "/search?tab=map", ready: "[data-missions-map]" });
await checkPage(page, "search-nothing", { path: `/search?q=${encodeURIComponent(`"${texts.label}" nothing`)}`, ...loadedResults });
await checkPage(page, "search-wrong", { path: `/search?q=${encodeURIComponent(`size:${texts.label}`)}`, allowedErrors: CLIENT_ERROR });
await checkPage(page, "people", { path: "/people", expectedTexts: [texts.person] });
await checkPage(page, "person", { path: `/people/${person}`, expectedTexts: [texts.person, texts.group] });
await checkPage(page, "access", { path: `/people/access?project=${ids.project}`, expectedTexts: [texts.person, texts.group, project] });
await checkPage(page, "groups", { path: "/groups", expectedTexts: [texts.group] });
await checkPage(page, "group", { path: `/groups/${ids.group}`, expectedTexts: [texts.group, texts.person] });
await checkPage(page, "account", { path: "/account" });
await checkPage(page, "tokens", { path: "/tokens", expectedTexts: [texts.token] });
await checkPage(page, "sessions", { path: "/sessions" });
await checkPage(page, "audit", { path: "/audit", expectedTexts: [project] });
await checkPage(page, "audit-groups", { path: "/audit?operation=group.*", expectedTexts: [texts.group] });
await checkPage(page, "trash", { path: "/trash", expectedTexts: [texts.gone, project] });
for (const tab of ["storage", "scrub", "jobs", "runners", "health", "settings"]) await checkPage(page, `admin-${tab}`, { path: `/admin?tab=${tab}` });
await checkPage(page, "not-found", { path: `/nowhere/${encodeURIComponent(texts.label)}`, allowedErrors: CLIENT_ERROR });
await checkPage(page, "signed-in", { path: "/signed-in", allowedErrors: WINDOW_NOT_CLOSED });

// Dialogs.
await page.goto(`${address}/projects`);
await page.getByRole("button", { name: "New project" }).first().click();
await checkPage(page, "dialog-project", { ...dialogOnly, ready: "dialog[open]" });
await page.goto(`${address}/actions`);
await page.getByRole("button", { name: "Add from library" }).first().click();
await page.locator("dialog[open] [data-shipped]").first().waitFor();
await page.locator("dialog[open]").getByLabel("Add to").selectOption({ label: project });
await checkPage(page, "dialog-library", { ...dialogOnly, ready: "dialog[open] [data-shipped]", expectedTexts: [project] });
await page.goto(`${address}${ofMission("")}`);
await page.locator("[data-lanes]").waitFor();
await page.getByRole("button", { name: /^Share/ }).first().click();
await checkPage(page, "dialog-share", { ...dialogOnly, ready: "dialog[open]", expectedTexts: [mission] });
await page.goto(`${address}/`);
await page.locator("h1").waitFor();
await page.keyboard.press("Control+k");
await checkPage(page, "dialog-palette", { ...dialogOnly, ready: "dialog[open]" });
await page.goto(`${address}/`);
await page.locator("h1").waitFor();
await page.keyboard.press("Shift+?");
await checkPage(page, "dialog-keys", { ...dialogOnly, ready: "dialog[open]" });
await checkPage(page, "dialog-slice", { ...dialogOnly, path: `/files/${ids.drive}?slice=1`, ready: "dialog[open] [data-estimate]" });

// Pages of the server, not of the app, for a signed-in person.
await checkPage(page, "device", { path: `/sign-in/device?user_code=${encodeURIComponent(texts.value)}`, expectedTexts: [texts.value] });
const loginQuery = new URLSearchParams({ port: "4444", state: texts.value, code_challenge: "x", client: texts.value });
await checkPage(page, "cli", { path: `/sign-in/cli?${loginQuery}`, ready: "#decision:not([hidden])", expectedTexts: [texts.value] });

// An anonymous visitor.
const unauthorized = { allowedErrors: UNAUTHORIZED };
const { page: anonymous, context: anonymousContext } = await openPage();
await checkPage(anonymous, "public", { ...unauthorized, path: "/public", expectedTexts: ["Lakes"] });
await checkPage(anonymous, "public-project", { ...unauthorized, path: `/projects/${ids.public}` });
await checkPage(anonymous, "public-mission", { ...unauthorized, path: `/missions/${ids.publicMission}`, ready: "[data-lanes]" });
await checkPage(anonymous, "public-project-checks", { ...unauthorized, path: `/projects/${ids.public}?tab=checks`, ready: "[data-matrix] [data-status=error]" });
await checkPage(anonymous, "public-project-rules", { ...unauthorized, path: `/projects/${ids.public}?tab=checks&part=rules`, ready: "[data-rules]", expectedTexts: ["/lake: {}"] });
await checkPage(anonymous, "public-mission-checks", { ...unauthorized, path: `/missions/${ids.publicMission}?tab=checks`, ready: "[data-checks] [role=row][data-index]", expectedTexts: ["topic.missing", "/lake"] });
await checkPage(anonymous, "public-file", { ...unauthorized, path: `/files/${ids.publicFile}`, ready: "[data-log-time]" });
await checkPage(anonymous, "public-search", { ...unauthorized, ...loadedResults, path: "/search" });
await checkPage(anonymous, "sign-in", { path: `/sign-in?return_to=${encodeURIComponent(texts.address)}` });
await checkPage(anonymous, "invitation", { path: new URL(unused).pathname + new URL(unused).hash, expectedTexts: [texts.person] });
await checkPage(anonymous, "reset", { path: "/sign-in/reset#not-a-code", allowedErrors: CLIENT_ERROR });
await checkPage(anonymous, "claim", { path: "/sign-in/bootstrap" });
await checkPage(anonymous, "link", { path: "/sign-in/link#not-a-code", allowedErrors: CLIENT_ERROR });
await checkPage(anonymous, "callback", { path: `/sign-in/callback/${encodeURIComponent("<img src=x>")}?error=${encodeURIComponent(texts.label)}`, allowedErrors: CLIENT_ERROR });
await checkPage(anonymous, "share", { path: new URL(share).pathname + new URL(share).hash, ready: "#files tr", expectedTexts: [project, mission, texts.recording] });
await anonymous.goto("about:blank");
await checkPage(anonymous, "shared-view", { path: `/s/view${new URL(share).hash}`, ready: "[data-panel]", expectedTexts: [mission] });
await anonymous.goto("about:blank");
await checkPage(anonymous, "share-ended", { path: "/s#not-a-secret", ready: "#message:not([hidden])", allowedErrors: CLIENT_ERROR });

results.inlineScripts = {};
for (const path of ["/", "/public", "/sign-in", "/s", "/s/view"]) results.inlineScripts[path] = await executesInlineScripts(anonymousContext, path === "/" ? "/search" : path);
await browser.close();
process.stdout.write(JSON.stringify(results));
