// What somebody waits for in the web interface, measured in the page itself: from the navigation or the click to the
// frame in which it is there. Prints the figures as JSON: milliseconds, bytes.
// Arguments: the folder with playwright-core, the browser, a link that signs in, the server's address, and as JSON the
// pages: how often to measure, names of project, mission and file, addresses of large missions and recordings.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [web, executablePath, link, address, told] = process.argv.slice(2);
const { chromium } = createRequire(`${web}/package.json`)("playwright-core");
const places = JSON.parse(told);
const PATIENCE_MS = 60_000;
const QUIET_MS = 500;
const JUMPS = 40;
const PLAYED_MS = 60_000;
const ROW = "[role=row][data-index]:not(:has(.coming))";
const HOME = [{ css: `[data-recent] ${ROW}` }];

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const size = { viewport: { width: 1440, height: 900 } };
const first = await browser.newContext(size);
const signing = await first.newPage();
await signing.goto(link);
await signing.waitForURL((url) => url.pathname === "/");
const storageState = await first.storageState();
await first.close();

/** Runs in the page: tells when all of it stands there, and how long the main thread was busy at a stretch. */
function watching([wanted, patienceMs]) {
  globalThis.tasks = [];
  new PerformanceObserver((list) => globalThis.tasks.push(...list.getEntries().map(({ startTime, duration }) => ({ startTime, duration }))))
    .observe({ type: "longtask", buffered: true });
  globalThis.isThere = (conditions) =>
    conditions.every(({ css, text = "", least = 1 }) => [...document.querySelectorAll(css)].filter((each) => each.textContent.includes(text)).length >= least);
  globalThis.shown = (conditions) =>
    new Promise((resolve, reject) => {
      const began = performance.now();
      const look = () => {
        if (globalThis.isThere(conditions)) setTimeout(() => resolve(performance.now())); // once this frame is painted
        else if (performance.now() - began > patienceMs) reject(new Error(`not there at ${location.href}: ${JSON.stringify(conditions)}`));
        else requestAnimationFrame(look);
      };
      requestAnimationFrame(look);
    });
  globalThis.wanted = globalThis.shown(wanted);
}

/** Somebody who comes for the first time: nothing is in the browser's cache. */
async function stranger(wanted, more = {}) {
  const context = await browser.newContext({ ...size, storageState, ...more });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  await page.addInitScript(watching, [wanted, PATIENCE_MS]);
  return { context, page };
}

/** Milliseconds from the navigation to all of it being there, from nothing; `look` sees the page afterwards. */
async function cold(path, wanted, look = async () => ({})) {
  const { context, page } = await stranger(wanted);
  await page.goto(`${address}${path}`, { waitUntil: "commit" });
  const milliseconds = await page.evaluate(() => globalThis.wanted);
  const seen = { milliseconds, ...(await look(page)) };
  await context.close();
  return seen;
}

/** Milliseconds from a click to all of it being there. */
async function clicked(page, css, conditions, text = "") {
  await page.locator(css).filter({ hasText: text }).first().waitFor();
  return page.evaluate(
    async ([wantedCss, wantedText, wanted]) => {
      const target = [...document.querySelectorAll(wantedCss)].find((each) => each.textContent.includes(wantedText));
      const began = performance.now();
      target.click();
      return (await globalThis.shown(wanted)) - began;
    },
    [css, text, conditions],
  );
}

/** The first load: all that comes over the network, compressed as most browsers ask for it, and when one can begin. */
async function firstLoad() {
  const { context, page } = await stranger(HOME, { extraHTTPHeaders: { "Accept-Encoding": "gzip" } });
  const network = await context.newCDPSession(page);
  await network.send("Network.enable");
  let [bytes, open, movedAt] = [0, 0, Date.now()];
  const streams = new Set();
  network.on("Network.requestWillBeSent", ({ requestId, type }) => {
    if (type === "EventSource") streams.add(requestId);
    else [open, movedAt] = [open + 1, Date.now()];
  });
  network.on("Network.responseReceived", ({ response }) => {
    const encoding = response.headers["content-encoding"];
    if (encoding !== undefined && encoding !== "gzip") throw new Error(`${response.url} came as ${encoding}`);
  });
  network.on("Network.loadingFinished", ({ requestId, encodedDataLength }) => {
    bytes += encodedDataLength;
    if (!streams.has(requestId)) [open, movedAt] = [open - 1, Date.now()];
  });
  network.on("Network.loadingFailed", ({ requestId, errorText }) => {
    if (!streams.has(requestId)) throw new Error(`the first load failed: ${errorText}`);
  });
  await page.goto(`${address}/`, { waitUntil: "commit" });
  const shownMs = await page.evaluate(() => globalThis.wanted);
  while (open > 0 || Date.now() - movedAt < QUIET_MS) await new Promise((resolve) => setTimeout(resolve, 20));
  const busyUntilMs = await page.evaluate(() => Math.max(0, ...globalThis.tasks.map(({ startTime, duration }) => startTime + duration)));
  await context.close();
  return { bytes, shownMs, milliseconds: Math.max(shownMs, busyUntilMs) };
}

/** Goes from page to page, as often as asked after a first round; returns the milliseconds of each change. */
async function changes() {
  const { context, page } = await stranger(HOME);
  await page.goto(`${address}/`);
  const title = (text) => ({ css: "h1", text });
  const rows = { css: `main ${ROW}` };
  const rail = (path, name, ...more) => [name, `.rail nav a[href="${path}"]`, [title(name), ...more]];
  const row = (name, ...more) => [name, "main a[data-way]", [title(name), ...more], name];
  const round = [
    rail("/projects", "Projects", rows), row(places.project, rows), row(places.many, rows, { css: "[data-lanes] path" }),
    rail("/projects", "Projects", rows), row(places.project, rows), row(places.large, rows), row(places.file, rows),
    rail("/search", "Search", rows), rail("/upload", "Upload"), rail("/people", "People", rows), rail("/trash", "Trash"),
    rail("/audit", "Record", rows), rail("/admin", "Admin"),
  ];
  const times = {};
  for (let number = 0; number <= places.times; number += 1) {
    for (const [name, css, wanted, text] of round) {
      const milliseconds = await clicked(page, css, wanted, text);
      if (number > 0) (times[name] ??= []).push(milliseconds);
    }
    const home = await clicked(page, '.rail a[href="/"]', HOME);
    if (number > 0) (times.home ??= []).push(home);
  }
  await context.close();
  return times;
}

/** The page of a mission with many files and topics: from a click in the list of missions, with nothing of it known. */
async function missionFromList() {
  const { context, page } = await stranger([{ css: "main a[data-way]", text: places.many }]);
  await page.goto(`${address}${places.projectPath}`, { waitUntil: "commit" });
  await page.evaluate(() => globalThis.wanted);
  const files = await clicked(page, "main a[data-way]", MANY, places.many);
  const topics = await clicked(page, "main a[href*='tab=topics']", TOPICS);
  const { longest } = await page.evaluate(() => ({ longest: Math.max(0, ...globalThis.tasks.map(({ duration }) => duration)) }));
  await context.close();
  return { files, topics, longest };
}

const MANY = [{ css: `main ${ROW}`, least: 10 }, { css: "[data-lanes] path" }];
const TOPICS = [{ css: `main ${ROW}`, text: "/" }, { css: `main ${ROW} svg[role=img] path`, least: 10 }];

/** The longest task of the main thread while somebody scrolls with a wheel, and then as fast as a scroll bar goes. */
async function scrolled(path, wanted, ready = async () => {}) {
  const { context, page } = await stranger(wanted);
  await page.goto(`${address}${path}`, { waitUntil: "commit" });
  await page.evaluate(() => globalThis.wanted);
  await ready(page);
  await page.mouse.move(700, 600);
  await page.evaluate(() => new Promise((resolve) => requestIdleCallback(resolve)));
  await page.evaluate(() => (globalThis.tasks.length = 0));
  for (let turn = 0; turn < places.turns; turn += 1) await page.mouse.wheel(0, turn % 10 === 9 ? -2400 : 600);
  await page.evaluate(async () => {
    const frame = () => new Promise(requestAnimationFrame);
    for (let at = 0; at < 60; at += 1) {
      window.scrollBy(0, document.documentElement.scrollHeight / 60);
      await frame();
    }
    await frame();
  });
  const seen = await page.evaluate(() => ({
    milliseconds: Math.max(0, ...globalThis.tasks.map(({ duration }) => duration)),
    long: globalThis.tasks.length,
    pixels: window.scrollY,
  }));
  await context.close();
  return seen;
}

const inLayout = (path, layout) => `${path}?${layout.map((panel) => `p=${encodeURIComponent(panel)}`).join("&")}`;
const VIEWED = [{ css: "[data-panel] [data-log-time]" }, { css: "[data-plot][data-messages]" }];
/** All panels are in sight: those out of sight are not read. */
const WIDE = { viewport: { width: 1920, height: 1080 } };
const SCRUBBER = "[data-transport] input[type=range]";

/** Opens the viewer, and jumps to times all over the mission: to each, away, and back; milliseconds and bytes. */
async function viewed() {
  const opened = await times(places.times, () => cold(places.viewerPath, VIEWED, bytesRead));
  const { context, page } = await stranger(VIEWED, WIDE);
  await page.goto(`${address}${inLayout(places.viewerPath, places.layout)}`, { waitUntil: "commit" });
  await page.evaluate(() => globalThis.wanted);
  const scrubber = page.locator(SCRUBBER);
  const jumps = { unread: [], read: [] };
  for (let number = 0; number < JUMPS; number += 1) {
    const [there, before] = [((number * 37) % 97) / 110, (((number - 1) * 37) % 97) / 110];
    jumps.unread.push(await scrubber.evaluate(jumped, there));
    if (number === 0) continue;
    await scrubber.evaluate(jumped, before);
    jumps.read.push(await scrubber.evaluate(jumped, there));
  }
  await context.close();
  return { opened, jumps };
}

/** Plays a minute, and then the same minute again and again; seconds, milliseconds, and bytes of the tab. */
async function played() {
  const { context, page } = await stranger(VIEWED, WIDE);
  await page.goto(`${address}${inLayout(places.playedPath, places.playedLayout)}`, { waitUntil: "commit" });
  await page.evaluate(() => globalThis.wanted);
  const scrubber = page.locator(SCRUBBER);
  await scrubber.evaluate(jumped, 0.01);
  const points = Number(await page.locator("[data-drawn-points]").getAttribute("data-drawn-points"));
  await page.evaluate(() => (globalThis.tasks.length = 0));
  const playHead = async () => Number(BigInt(await page.locator("[data-transport]").getAttribute("data-time")) / 1_000_000n) / 1_000;
  const from = await playHead();
  const began = performance.now();
  await page.locator("body").press(" ");
  await page.waitForTimeout(PLAYED_MS);
  await page.locator("body").press(" ");
  const seconds = (performance.now() - began) / 1_000;
  const { longest, long } = await page.evaluate(() => ({ longest: Math.max(0, ...globalThis.tasks.map(({ duration }) => duration)), long: globalThis.tasks.length }));
  const shownSeconds = (await playHead()) - from;
  const renderer = await rendererOf(page);
  const tabBytes = [];
  const memoryFrom = performance.now();
  for (const until = memoryFrom + places.memoryMs; performance.now() < until; ) {
    await scrubber.evaluate(jumped, 0.01);
    await page.locator("body").press(" ");
    for (let part = 0; part < 6; part += 1) {
      await page.waitForTimeout(PLAYED_MS / 6);
      tabBytes.push(privateBytes(renderer));
    }
    await page.locator("body").press(" ");
  }
  await context.close();
  return { seconds, played: shownSeconds, longest, long, points, tabBytes, minutes: (performance.now() - memoryFrom) / 60_000 };
}

/** The process of a page's tab: of all tabs, that with the most CPU time, since no other does anything. */
async function rendererOf(page) {
  const session = await page.context().browser().newBrowserCDPSession();
  const { processInfo } = await session.send("SystemInfo.getProcessInfo");
  await session.detach();
  return processInfo.filter(({ type }) => type === "renderer").toSorted((one, other) => other.cpuTime - one.cpuTime)[0].id;
}

/** Bytes of a process that are its own, and its share of those that it shares with others. */
function privateBytes(pid) {
  const [, kilobytes] = /^Pss:\s+(\d+) kB/m.exec(readFileSync(`/proc/${pid}/smaps_rollup`, "utf8"));
  return Number(kilobytes) * 1024;
}

/** Runs in the page: moves the scrubber to a share of the time; milliseconds until all panels of messages show it. */
async function jumped(scrubber, share) {
  const began = performance.now();
  scrubber.value = String(Number(scrubber.max) * share);
  scrubber.dispatchEvent(new Event("input", { bubbles: true }));
  const isRight = () => {
    const time = BigInt(document.querySelector("[data-transport]").dataset.time);
    return [...document.querySelectorAll("[data-panel] [data-log-time]")].every(({ dataset }) => {
      const age = time - BigInt(dataset.logTime);
      return age >= 0n && age < 150_000_000n;
    });
  };
  await new Promise(requestAnimationFrame);
  while (!isRight()) {
    if (performance.now() - began > 30_000) throw new Error("the panels do not show the time of the play head");
    await new Promise(requestAnimationFrame);
  }
  return performance.now() - began;
}

async function times(count, measure) {
  const found = [];
  for (let number = 0; number < count; number += 1) found.push(await measure());
  return found;
}

const bytesRead = async (page) => ({ bytes: Number(await page.locator("[data-bytes-read]").getAttribute("data-bytes")) });
const openAll = async (page) => {
  await page.getByRole("button", { name: "Open all folders" }).click();
  await page.waitForFunction((least) => Number(document.querySelector("main [role=table]")?.getAttribute("aria-rowcount")) > least, places.files);
};
const asked = new Set(places.asked);
const result = {};
if (asked.has("load")) result.load = await times(places.times, firstLoad);
if (asked.has("changes")) result.changes = await changes();
if (asked.has("mission")) {
  result.mission = await times(places.times, missionFromList);
  result.missionCold = await times(places.times, () => cold(places.manyPath, MANY));
  result.topicsCold = await times(places.times, () => cold(`${places.manyPath}?tab=topics`, TOPICS));
}
if (asked.has("picture")) {
  for (const [name, path] of Object.entries(places.pictures)) {
    (result.pictures ??= {})[name] = await times(places.times, () => cold(path, [{ css: "[data-log-time]" }], bytesRead));
  }
}
if (asked.has("viewer")) result.viewer = await viewed();
if (asked.has("playing")) result.playing = await played();
if (asked.has("scroll")) {
  const shownRows = [{ css: `main ${ROW}`, least: 3 }];
  const scrolls = {
    [`a mission of ${places.files} files`]: [places.filesPath, shownRows, openAll],
    [`${places.topics} topics of a mission`]: [`${places.manyPath}?tab=topics`, TOPICS],
    [`${places.found} files of a search`]: ["/search", [...shownRows, { css: "[data-facets] li" }]],
  };
  result.scrolls = {};
  for (const [name, scroll] of Object.entries(scrolls)) result.scrolls[name] = await times(places.times, () => scrolled(...scroll));
}
await browser.close();
process.stdout.write(JSON.stringify(result));
