// The viewer's panels of positions, states, rows, frames and images: opens each at a time, reads what it shows, and uses it.
// Prints the results as JSON. Arguments: the folder with playwright-core, the browser, a sign-in link, the server's
// address, the folder for screenshots, and what to open as JSON.
import { openBrowser } from "./browsing.mjs";
import { imagePanels } from "./image_panels.mjs";

const [web, executablePath, link, address, pictures, request] = process.argv.slice(2);
const { auv, drive, turtles, images, times, damagedTimes, videos } = JSON.parse(request);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
const { context, page } = await openPage();
await context.grantPermissions(["clipboard-read", "clipboard-write"]);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const texts = (selector) => page.locator(selector).allTextContents();
const attribute = (selector, name) => page.locator(selector).first().getAttribute(name);
const playHead = () => attribute("[data-transport]", "data-time");

async function open(file, time, ...panels) {
  const query = new URLSearchParams([["t", time], ...panels.map((panel) => ["p", panel.replace("KEY", file.slice(0, 8))])]);
  await page.goto(`${address}/files/${file}/view?${query}`);
  await page.locator("[data-viewer]").waitFor();
}

/** Waits until the play head is somewhere else, and returns where. */
async function headAfter(act) {
  const before = await playHead();
  await act();
  await page.waitForFunction((time) => document.querySelector("[data-transport]")?.getAttribute("data-time") !== time, before);
  return playHead();
}

async function mapOf(file, topic, time) {
  await open(file, time, `map:KEY@${topic}`);
  const row = `[data-series="${topic}"]`;
  await page.locator(`${row}[data-positions][data-log-time]`).waitFor();
  const result = {
    positions: Number(await attribute(row, "data-positions")),
    missing: Number(await attribute(row, "data-missing")),
    logTime: await attribute(row, "data-log-time"),
    position: (await texts(`${row} [data-position]`))[0],
    altitude: (await texts(`${row} [data-altitude]`))[0] ?? null,
    path: await attribute("[data-track]", "d"),
    metresPerPixel: Number(await attribute("[data-map]", "data-metres-per-pixel")),
    hasHead: (await page.locator("[data-head]").count()) === 1,
  };
  await checkPage(page, `viewer-map${topic.replaceAll("/", "-")}`);
  return result;
}

async function clickTrackStart() {
  const [left, top] = /^M(\S+) (\S+?)[LM]/.exec(await attribute("[data-track]", "d")).slice(1).map(Number);
  return headAfter(() => page.locator("[data-map]").click({ position: { x: left, y: top } }));
}

/** Zooms and moves by wheel and keys; returns how the scale changed. */
async function zoomMap() {
  const scale = async () => Number(await attribute("[data-map]", "data-metres-per-pixel"));
  // The window has its size again.
  await page.waitForFunction((fitted) => Number(document.querySelector("[data-map]").dataset.metresPerPixel) === fitted, results.map.metresPerPixel);
  const [whole, head] = [await scale(), await playHead()];
  await page.locator("[data-map]").hover();
  await page.mouse.wheel(0, -240);
  await page.waitForFunction((before) => Number(document.querySelector("[data-map]").dataset.metresPerPixel) < before, whole);
  const wheel = await scale();
  await page.locator("[data-map]").focus();
  await page.keyboard.press("+");
  const key = await scale();
  const before = await attribute("[data-track]", "d");
  await page.keyboard.press("ArrowLeft");
  const isMoved = (await attribute("[data-track]", "d")) !== before;
  await page.keyboard.press("0");
  return { wheel: whole / wheel, key: wheel / key, isMoved, fitted: whole / (await scale()), isHeadSame: (await playHead()) === head };
}

async function statesOf(file, topic, time) {
  await open(file, time, `states*:KEY@${topic},status.status,status.service,header.frame_id`);
  await page.locator(`[data-series="${topic}"][data-messages] [data-state] .state-bar`).first().waitFor();
  await page.waitForFunction(() => document.querySelector("[data-described]")?.textContent.includes("STATUS"));
  const rows = await page.locator("[data-state]").evaluateAll((elements) =>
    elements.map((element) => ({
      field: element.dataset.state,
      runs: Number(element.dataset.runs),
      bars: element.querySelectorAll(".state-bar").length,
      described: element.querySelector("[data-described]").textContent,
    })),
  );
  const row = page.locator('[data-state="status.status"]');
  const next = await headAfter(() => row.getByRole("button", { name: "Next change" }).click());
  const describedNext = await row.locator("[data-described]").textContent();
  const previous = await headAfter(() => row.getByRole("button", { name: "Previous change" }).click());
  const box = await row.locator("[data-strip]").boundingBox();
  const clicked = await headAfter(() => row.locator("[data-strip]").click({ position: { x: box.width / 2, y: 10 } }));
  const result = { rows, next, describedNext, previous, clicked };
  await checkPage(page, "viewer-states");
  return result;
}

async function tableOf(file, topic, time) {
  await open(file, time, `table*:KEY@${topic},linear_acceleration.x,header.frame_id`);
  await page.locator("[data-table][data-rows] [aria-current]").waitFor();
  const rows = await page.locator("[data-table] tbody tr").evaluateAll((elements) => elements.map((row) => [row.dataset.time, ...Array.from(row.querySelectorAll(".cell"), (cell) => cell.title)]));
  const current = await attribute("[data-table] [aria-current]", "data-time");
  await page.getByRole("button", { name: "Copy as CSV" }).click();
  const csv = await page.evaluate("navigator.clipboard.readText()");
  // A message that lies over buttons on a phone hides them from axe.
  await page.getByRole("log").getByRole("button", { name: "Dismiss" }).first().click();
  const clicked = await headAfter(() => page.locator("[data-table] tbody tr").nth(2).locator("button").click());
  const result = { rows, current, csv, clicked };
  await page.locator("[data-table][data-rows]").waitFor();
  await checkPage(page, "viewer-table");
  return result;
}

async function framesOf(file, time, frame, reference) {
  await open(file, time, `tf:KEY@/tf,${frame},${reference}`);
  await page.locator("[data-frames][data-count] [data-translation]").waitFor();
  const rows = await page.locator("[data-frame]").evaluateAll((elements) =>
    elements.map((element) => ({ frame: element.dataset.frame, depth: Number(element.dataset.depth), time: element.querySelector(".age")?.dataset.time ?? null, text: element.querySelector(".age")?.textContent ?? null })),
  );
  return { rows, translation: (await texts("[data-translation]"))[0], rotation: (await texts("[data-rotation]"))[0] };
}

results.map = await mapOf(drive, "/fix", times.drive);
results.zoom = await zoomMap();
results.clicked = await clickTrackStart();
results.withoutFix = await mapOf(auv, "/coug2/fix", times.auv);
results.states = await statesOf(auv, "/coug2/fix", times.auv);
results.table = await tableOf(drive, "/imu/data", times.drive);
results.auvFrames = await framesOf(auv, times.auvFrames, "coug2.robot", "enu");
results.turtleFrames = await framesOf(turtles, times.turtles, "carrot", "turtle2");
await checkPage(page, "viewer-frames");
await page.getByRole("button", { name: "world" }).click();
await page.waitForFunction((before) => document.querySelector("[data-translation]")?.textContent !== before, results.turtleFrames.translation);
results.selected = { translation: (await texts("[data-translation]"))[0], address: decodeURIComponent(page.url()) };

const panels = imagePanels({ page, open, checkPage: (name) => checkPage(page, name) });
results.depth = await panels.depth(images, times.images);
results.annotated = await panels.annotated(images, times.images);
results.damaged = await panels.damaged(images, damagedTimes);
results.videos = {};
for (const video of videos) results.videos[video.topic] = await panels.video(images, video);
await printResults();
