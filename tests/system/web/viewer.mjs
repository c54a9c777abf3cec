// The viewer of a mission: panels at the first time, playing, keys, another time, a link, a plot, a log, a file, and a
// phone; and what a share link to some files shows of it. Prints the results as JSON. Arguments: the folder with
// playwright-core and axe-core, the browser, a sign-in link, the server's address, the folder for screenshots, the ids of
// the mission and of one of its files, as JSON the panels by name as the address writes them, a log time, the address
// of the share link and its id.
import { readFile } from "node:fs/promises";
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures, missionId, fileId, panelsText, laterNs, shareLink, shareId] = process.argv.slice(2);
const panels = JSON.parse(panelsText);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
const { context, page } = await openPage();
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const viewAddress = (kinds, query = "") => `${address}/missions/${missionId}/view?${kinds.map((kind) => `p=${encodeURIComponent(panels[kind])}`).join("&")}${query}`;
const panel = (place, tab = page) => tab.locator("[data-panel]").nth(place);
const timeOf = (tab = page) => tab.locator("[data-transport]").getAttribute("data-time");
const logTime = (place, tab = page) => panel(place, tab).locator("[data-log-time]").getAttribute("data-log-time");

/** Waits until a panel shows a message of another time than before. */
const changed = (place, before) =>
  page.waitForFunction(([at, time]) => {
    const shown = document.querySelectorAll("[data-panel]")[at]?.querySelector("[data-log-time]")?.getAttribute("data-log-time");
    return shown && shown !== time;
  }, [place, before]);

/** Returns the grey values of an image panel in base64, its size and its log time. */
async function pictureOf(place, tab = page) {
  const canvas = panel(place, tab).locator("canvas[role=img]");
  const pixels = await canvas.evaluate((element) => {
    const copy = new OffscreenCanvas(element.width, element.height).getContext("2d", { willReadFrequently: true });
    copy.drawImage(element, 0, 0);
    const { data } = copy.getImageData(0, 0, element.width, element.height);
    let text = "";
    for (let at = 1; at < data.length; at += 4) text += String.fromCharCode(data[at]);
    return { width: element.width, height: element.height, grey: btoa(text) };
  });
  return { ...pixels, logTime: await logTime(place, tab) };
}

/** Returns the leaves of a raw panel: their labels and values. */
async function messageOf(place, tab = page) {
  await panel(place, tab).locator("[data-log-time] [data-value]").first().waitFor({ state: "attached" });
  const leaves = await panel(place, tab).locator("[data-value]").evaluateAll((all) => all.map((leaf) => [leaf.dataset.value, leaf.textContent]));
  return { leaves, logTime: await logTime(place, tab) };
}

async function plotOf(place, tab = page) {
  await panel(place, tab).locator("[data-plot][data-messages]").waitFor();
  const values = await panel(place, tab).locator("[data-field-value]").evaluateAll((all) => all.map(({ dataset }) => [dataset.fieldValue, dataset.value]));
  return { values, messages: await panel(place, tab).locator("[data-plot]").getAttribute("data-messages"), label: await panel(place, tab).locator("[role=img]").first().getAttribute("aria-label") };
}

async function goTo(kinds, timeNs) {
  await page.goto(viewAddress(kinds, `&t=${timeNs}`));
  await panel(kinds.length - 1).waitFor();
}

// The default layout, reached by the button on the page of the mission.
await page.goto(`${address}/missions/${missionId}`);
await page.getByRole("link", { name: "View", exact: true }).click();
await panel(0).locator("[data-log-time]").waitFor();
results.defaults = await page.locator("[data-panel]").evaluateAll((all) => all.map((one) => one.getAttribute("aria-label")));
results.bytesRead = Number(await page.locator("[data-bytes-read]").getAttribute("data-bytes"));

// Each format at a time in the middle.
await goTo(["mcapImage", "bagImage", "db3Image", "imu", "plot"], laterNs);
for (const place of [0, 1, 2, 3]) await panel(place).locator("[data-log-time]").waitFor();
results.later = { time: await timeOf(), mcap: await pictureOf(0), bag: await pictureOf(1), db3: await pictureOf(2), imu: await messageOf(3), plot: await plotOf(4) };
results.notice = await panel(4).locator("[data-unread]").innerText();
await panel(4).getByRole("button", { name: /^Read all/ }).click();
await panel(4).locator("[data-unread]").waitFor({ state: "detached" });
results.whole = await plotOf(4);
await checkPage(page, "viewer");

// Keys: the next and previous message of the selected panel, one second, the ends.
await panel(0).locator("h2").click();
for (const [name, key] of [["next", "."], ["nextAgain", "."], ["previous", ","]]) {
  const before = await logTime(0);
  await page.keyboard.press(key);
  await changed(0, before);
  results[name] = await pictureOf(0);
}
const beforeSecond = BigInt(await timeOf());
await page.keyboard.press("ArrowRight");
results.second = String(BigInt(await timeOf()) - beforeSecond);
await page.keyboard.press("Home");
results.home = await timeOf();
await page.keyboard.press("End");
results.end = await timeOf();

// The track of the preview at once, and after reading all, the positions.
await goTo(["map"], laterNs);
await panel(0).locator("[data-rough]").waitFor();
await panel(0).locator("[data-positions][data-log-time]").waitFor();
const lengthOf = (selector) => panel(0).locator(selector).evaluateAll((paths) => paths.reduce((sum, path) => sum + path.getTotalLength(), 0));
const positionsRead = async () => Number(await panel(0).locator("[data-positions]").getAttribute("data-positions"));
const rough = { positions: await positionsRead(), rough: await lengthOf("[data-rough-track]"), read: await lengthOf("[data-track]"), marks: await panel(0).locator("[data-mark]").allTextContents() };
await checkPage(page, "viewer-map-rough");
await panel(0).getByRole("button", { name: "Read all" }).click();
await panel(0).locator("[data-rough]").waitFor({ state: "detached" });
await panel(0).locator("[data-positions]").waitFor();
results.map = { ...rough, whole: { positions: await positionsRead(), rough: await lengthOf("[data-rough-track]"), read: await lengthOf("[data-track]") } };

// Playing goes forward, and the space bar stops it.
await goTo(["mcapImage", "imu"], laterNs);
await panel(1).locator("[data-log-time]").waitFor();
const [startTime, startImage] = [BigInt(await timeOf()), await logTime(0)];
await page.locator("body").press(" ");
const started = performance.now();
await page.waitForFunction((time) => BigInt(document.querySelector("[data-transport]").dataset.time) > BigInt(time) + 1_000_000_000n, String(startTime));
const elapsedMs = performance.now() - started;
await page.locator("body").press(" ");
await page.locator("[data-transport]:not([data-playing])").waitFor();
const pausedAt = await timeOf();
await page.waitForTimeout(300);
results.playing = { elapsedMs, playedNs: String(BigInt(pausedAt) - startTime), movedImage: (await logTime(0)) !== startImage, isStill: (await timeOf()) === pausedAt };

// A link shows the same panels at the same time, in another window.
await context.grantPermissions(["clipboard-read", "clipboard-write"]);
await panel(0).getByRole("button", { name: "Full width" }).click();
await page.getByRole("button", { name: "Begin the loop here" }).click();
await page.getByRole("button", { name: "Copy link" }).click();
const copied = await page.evaluate(() => navigator.clipboard.readText());
const other = await context.newPage();
await other.goto(copied);
await panel(1, other).locator("[data-log-time]").waitFor();
await panel(0, other).locator("[data-log-time]").waitFor();
const shown = async (tab) => ({
  time: await timeOf(tab),
  image: await pictureOf(0, tab),
  imu: await messageOf(1, tab),
  panels: await tab.locator("[data-panel]").evaluateAll((all) => all.map((one) => [one.getAttribute("aria-label"), one.className.includes("wide")])),
  loop: new URL(copied).searchParams.get("from"),
});
results.link = { address: copied, before: await shown(page), after: await shown(other) };
await other.close();

// A plot of two topics: a click sets the time; a field is added in the panel.
await goTo(["twoTopics"], laterNs);
results.twoTopics = await plotOf(0);
const middle = (BigInt(results.home) + BigInt(results.end)) / 2n;
// While curves come, the plot is made anew, and a click may meet none.
for (let number = 0; number < 20; number += 1) {
  const canvas = await panel(0).locator(".u-over").boundingBox();
  await page.mouse.click(canvas.x + canvas.width / 2, canvas.y + canvas.height / 2);
  await page.waitForTimeout(250);
  results.clicked = await timeOf();
  const distance = BigInt(results.clicked) - middle;
  if (distance < 50_000_000n && distance > -50_000_000n) break;
}
async function addAngularVelocity() {
  await panel(0).locator("[data-field='angular_velocity.x']").click();
  await panel(0).locator("[data-field-value='angular_velocity.x']").waitFor();
}
async function openFields() {
  await panel(0).getByRole("button", { name: "Fields" }).click();
  await panel(0).locator("[data-series='/imu/data'] summary", { hasText: /^angular_velocity$/ }).click();
}
await openFields();
await addAngularVelocity();
results.added = (await plotOf(0)).values.map(([field]) => field);

/** Returns the time at a place of the plot, from 0 to 1. While the page has its new size and colours, the plot is made anew. */
async function timeAtPointer(share) {
  await page.mouse.move(0, 0);
  await panel(0).locator("[data-plot][data-messages]").waitFor();
  for (let number = 0; number < 60 && (await panel(0).locator("[data-pointer]").count()) === 0; number += 1) {
    const box = await panel(0).locator(".u-over").boundingBox();
    await page.mouse.move(box.x + box.width * share, box.y + box.height / 2 + (number % 2));
    await page.waitForTimeout(250);
  }
  return panel(0).locator("[data-pointer]").getAttribute("data-pointer");
}

// What is zoomed in stays so when a curve is added, for which all are read again. A tenth from the left is not near the start.
await goTo(["plot"], laterNs);
await openFields();
results.zoomed = { before: await timeAtPointer(0.1) };
for (let number = 0; number < 10 && BigInt(await timeAtPointer(0.1)) < (BigInt(results.home) + middle) / 2n; number += 1) {
  const box = await panel(0).locator(".u-over").boundingBox();
  await page.mouse.move(box.x + box.width * 0.4, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width * 0.6, box.y + box.height / 2, { steps: 4 });
  await page.mouse.up();
}
results.zoomed.zoomed = await timeAtPointer(0.1);
await addAngularVelocity();
results.zoomed.added = await timeAtPointer(0.1);

// Computed curves on two axes, over log times and those of headers; the same by a link; values at the pointer.
async function computedPlot() {
  await panel(0).locator("[data-plot][data-messages]").waitFor();
  await page.waitForFunction(() => [...document.querySelectorAll("[data-field-value]")].every(({ dataset }) => dataset.value !== undefined));
  const { values } = await plotOf(0);
  return {
    values,
    units: await panel(0).locator("[data-field-value]").evaluateAll((all) => all.map(({ dataset }) => [dataset.fieldValue, dataset.unit ?? null, dataset.side])),
    axes: await panel(0).locator(".u-axis").count(),
    unstamped: (await panel(0).locator("[data-header-time]").count()) ? await panel(0).locator("[data-header-time]").getAttribute("data-unstamped") : null,
    needsZoom: (await panel(0).locator("[data-zoom-needed]").count()) > 0,
  };
}
await goTo(["computed"], laterNs);
results.computed = { logged: await computedPlot() };
await checkPage(page, "viewer-computed");
const [span, now] = [BigInt(results.end) - BigInt(results.home), BigInt(laterNs) - BigInt(results.home)];
// Beside the play head, where the messages were read.
results.computed.pointer = { timeNs: await timeAtPointer(Number(now - 800_000_000n) / Number(span)), values: (await plotOf(0)).values };
await page.mouse.move(0, 0);
await goTo(["header"], laterNs);
results.computed.stamped = await computedPlot();
await page.getByRole("button", { name: "Copy link" }).click();
await page.goto(await page.evaluate(() => navigator.clipboard.readText()));
results.computed.reopened = await computedPlot();

// The same is set by controls, with the keyboard.
await goTo(["twoTopics"], laterNs);
await panel(0).locator("[data-plot][data-messages]").waitFor();
await panel(0).getByRole("button", { name: "Fields" }).press("Enter");
const imu = panel(0).locator("[data-series='/imu/data']");
await imu.getByLabel("Compute", { exact: true }).selectOption("norm");
await imu.getByLabel("Of the field").selectOption("angular_velocity");
await imu.getByRole("button", { name: "Add curve" }).press("Enter");
await imu.locator("[data-side-of='norm(angular_velocity)']").press("Enter");
await imu.locator("[data-field-value='norm(angular_velocity)'][data-side='right']").waitFor();
await panel(0).getByLabel("Time of messages").selectOption("header");
await panel(0).locator("[data-header-time]").waitFor();
await checkPage(page, "viewer-curves");
results.computed.added = { values: (await plotOf(0)).values.map(([field]) => field), address: decodeURIComponent(page.url()) };

// A log: its level, and a click on a line.
await goTo(["log"], laterNs);
await page.locator("[data-log][data-lines]").waitFor();
results.log = { lines: await page.locator("[data-log]").getAttribute("data-lines"), texts: await page.locator("[data-log] .text").allInnerTexts() };
await page.getByLabel("Level").selectOption("error");
await page.waitForFunction(() => document.querySelectorAll("[data-log] .text").length <= 10);
results.log.errors = await page.locator("[data-log] .text").allInnerTexts();
const line = page.locator("[data-log] tbody tr").first();
const lineTime = await line.getAttribute("data-time");
await line.getByRole("button").click();
results.log.jumped = [await timeOf(), lineTime];
await checkPage(page, "viewer-log");

// A panel is added, and a topic before its first message says so.
await page.goto(`${address}/files/${fileId}/view`);
await panel(0).waitFor();
await page.getByRole("button", { name: "Add panel" }).click();
await page.getByLabel("Filter topics").fill("gps");
await checkPage(page, "viewer-add");
const count = await page.locator("[data-panel]").count();
await page.getByRole("button", { name: "Raw messages of /gps/fix" }).click();
await page.keyboard.press("Home");
await panel(count).locator("[data-no-message]").waitFor();
await panel(count).getByRole("button", { name: "Go to the first message" }).click();
results.gps = await messageOf(count);
await checkPage(page, "viewer-file");

// The shown topics and the loop as an MCAP, which other programs open.
await page.addInitScript(() => (window.showSaveFilePicker = undefined));
await page.goto(viewAddress(["imu"], `&t=${laterNs}&from=${laterNs}&to=${BigInt(laterNs) + 1_000_000_000n}`));
await page.getByRole("button", { name: "Open in…" }).click();
await page.locator("[data-slice-of-view]").waitFor();
const [sliced] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Download drive.mcap" }).click()]);
await page.locator("[data-slice-of-view] [data-saved]").waitFor();
results.sliced = { name: sliced.suggestedFilename(), bytes: (await readFile(await sliced.path())).toString("base64"), command: await page.locator("[data-elsewhere] pre, [data-elsewhere] code").first().innerText() };
await checkPage(page, "viewer-elsewhere");
await page.getByRole("button", { name: /^Open the whole file/ }).click();
await page.locator("a[data-viewer]").first().waitFor();
results.sliced.viewers = await page.locator("a[data-viewer]").evaluateAll((all) => all.map((one) => one.getAttribute("href")));

// Somebody without an account opens a share link, and the viewer from its page.
let isRefused = false;
const { page: guest } = await openPage(() => isRefused);
const secret = new URL(shareLink).hash.slice(1);
const requested = [];
guest.on("request", (request) => requested.push({ url: request.url(), isOfApi: new URL(request.url()).pathname.startsWith("/api/"), headers: request.headers() }));
await guest.goto(shareLink);
await guest.getByRole("link", { name: "View the recordings" }).click();
await panel(0, guest).locator("[data-log-time]").waitFor();
results.shared = {
  defaults: await guest.locator("[data-panel]").evaluateAll((all) => all.map((one) => one.getAttribute("aria-label"))),
  links: await guest.locator("a").evaluateAll((all) => all.map((one) => one.getAttribute("href"))),
  buttons: await guest.locator(".head .actions button").allInnerTexts(),
};
await guest.getByRole("button", { name: "Add panel" }).click();
results.shared.topics = await guest.locator("dialog[open] .topic .about").allInnerTexts();
await guest.keyboard.press("Escape");
await checkPage(guest, "viewer-shared");
const query = ["mcapImage", "plot", "imu", "log"].map((kind) => `p=${encodeURIComponent(panels[kind])}`).join("&");
await guest.goto(`${address}/s/view?${query}&t=${laterNs}#${secret}`);
await panel(2, guest).locator("[data-log-time]").waitFor();
await panel(0, guest).locator("[data-log-time]").waitFor();
await guest.keyboard.press("ArrowRight");
await guest.keyboard.press("ArrowLeft");
await guest.waitForTimeout(600);
Object.assign(results.shared, { time: await timeOf(guest), image: await pictureOf(0, guest), plot: await plotOf(1, guest), hiddenLines: await panel(3, guest).locator("[data-log] .text").count(), keepsSecret: new URL(guest.url()).hash === `#${secret}` });
results.shared.sentSecret = requested.filter(({ url }) => url.split("#")[0].includes(secret)).length;
results.shared.withoutLink = requested.filter(({ isOfApi, headers }) => isOfApi && (headers.authorization !== `Bearer ${secret}` || headers.cookie !== undefined)).map(({ url }) => url);
isRefused = true;
await page.evaluate((id) => fetch(`/api/v1/shares/${id}`, { method: "DELETE" }), shareId);
await guest.reload();
await guest.getByRole("heading", { name: "This link has ended", exact: false }).first().waitFor();
await checkPage(guest, "viewer-shared-ended");
await printResults();
