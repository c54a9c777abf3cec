// 3D panels: opens recordings with points, transforms and markers, and reads what the panels say that they show.
// Prints the results as JSON. Arguments: the folder with playwright-core, the browser, a sign-in link, the server's
// address, the folder for pictures, and as JSON the panels: [{ name, file, time, series: ["/topic"], points }], and one
// more, for which the store holds the recording back, and then refuses it.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures, json, late] = process.argv.slice(2);
const KEY_LENGTH = 8;
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let isRefused = false;
const { page } = await openPage(() => isRefused);
results.views = {};
// Of the worker that draws, since scripts of a page do not run there.
const COUNT_LINKS = `globalThis.linkedPrograms = 0;
const { linkProgram } = WebGL2RenderingContext.prototype;
WebGL2RenderingContext.prototype.linkProgram = function link(program) {
  globalThis.linkedPrograms += 1;
  return linkProgram.call(this, program);
};
`;
await page.route(/\/scene_worker[^/]*\.js$/, async (route) => {
  const response = await route.fetch();
  await route.fulfill({ response, body: `${COUNT_LINKS}${await response.text()}` });
});
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const scene = page.locator("[data-scene]");

/** Opens a 3D panel. */
async function go({ file, time, series }) {
  const key = file.slice(0, KEY_LENGTH);
  const panel = `scene*:${series.map((topic) => `${key}@${topic}`).join(";")}`;
  await page.goto(`${address}/files/${file}/view?${new URLSearchParams({ ...(time ? { t: time } : {}), p: panel })}`);
}

/** Opens a 3D panel and waits until all topics and the expected points are shown. */
async function open(view) {
  await go(view);
  await isShown(view);
}

async function isShown({ series, points }) {
  await page.waitForFunction((count) => document.querySelectorAll("[data-scene-topic][data-log-time]").length === count, series.length);
  await page.locator(`[data-drawn-points="${points}"]`).waitFor();
}

async function state() {
  const topics = await page.locator("[data-scene-topic]").evaluateAll((rows) => rows.map((row) => ({ ...row.dataset, text: row.textContent })));
  const canvas = page.locator("[data-scene] canvas");
  const { fixedFrame, items } = await scene.evaluate((element) => ({ ...element.dataset }));
  const missing = await page.locator("[data-missing-transform]").allTextContents();
  return { topics, label: await canvas.getAttribute("aria-label"), fixedFrame, items: Number(items), missing, colours: await colours(canvas) };
}

const BACKGROUND_COLOURS = 20;

/** Returns how many different colours the drawing has. What the worker has drawn is seen a moment later. */
async function colours(canvas) {
  let count = await coloursOf(canvas);
  for (let number = 0; count <= BACKGROUND_COLOURS && number < 50; number += 1) {
    await page.waitForTimeout(100);
    count = await coloursOf(canvas);
  }
  return count;
}

/** Reads a screenshot, since WebGL keeps no picture. */
async function coloursOf(canvas) {
  const bytes = (await canvas.screenshot()).toString("base64");
  return page.evaluate(async (text) => {
    const bitmap = await createImageBitmap(new Blob([Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0))], { type: "image/png" }));
    const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
    context.drawImage(bitmap, 0, 0);
    return new Set(new Uint32Array(context.getImageData(0, 0, bitmap.width, bitmap.height).data.buffer)).size;
  }, bytes);
}

/** Shows the cloud of the preview before the recorded one, and instead of it. */
async function showLate(view) {
  const preview = new URL((await (await page.request.get(`${address}/api/v1/files/${view.file}/preview`)).json()).url);
  let release;
  const released = new Promise((resolve) => (release = resolve));
  await page.route((url) => url.searchParams.has("X-Amz-Signature") && url.pathname !== preview.pathname, async (route) => {
    await released;
    return isRefused ? route.fulfill({ status: 404, headers: { "access-control-allow-origin": "*" } }) : route.continue();
  });
  const rough = async () => {
    await page.locator("[data-scene-topic][data-rough]").waitFor({ state: "attached" });
    await page.locator('[data-scene][data-items="1"] [data-drawn-points]:not([data-drawn-points="0"])').waitFor();
    return { ...(await state()), notice: await page.locator("[data-rough-cloud]").allTextContents(), failures: await page.locator("[data-scene-topic] [data-read-failure]").count() };
  };
  await go(view);
  results.views.rough = await rough();
  await page.screenshot({ path: `${pictures}/scene-rough.png` });
  release();
  await isShown(view);
  results.views.afterRough = { ...(await state()), notice: await page.locator("[data-rough-cloud]").allTextContents() };
  isRefused = true;
  await go(view);
  await page.locator("[data-scene-topic] [data-read-failure]").waitFor();
  results.views.refused = await rough();
  await checkPage(page, "scene-refused");
  await page.screenshot({ path: `${pictures}/scene-refused.png` });
}

/** Shows one cloud after the other; returns the shader programs that were linked before and afterwards. */
async function step(view) {
  await open(view);
  const topic = page.locator("[data-scene-topic]");
  const drawing = page.workers().find((worker) => worker.url().includes("/scene_worker"));
  const linked = () => drawing.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => setTimeout(() => resolve(globalThis.linkedPrograms)))));
  const stepped = { times: [await topic.getAttribute("data-log-time")], before: await linked() };
  for (let number = 0; number < 3; number += 1) {
    await page.keyboard.press("ArrowRight");
    await page.waitForFunction((time) => document.querySelector("[data-scene-topic]").dataset.logTime > time, stepped.times.at(-1));
    stepped.times.push(await topic.getAttribute("data-log-time"));
    await linked();
  }
  return { ...stepped, after: await linked() };
}

const views = JSON.parse(json);
results.stepped = await step(views[0]);
for (const view of views) {
  await open(view);
  if (view.missing) await page.waitForFunction((count) => document.querySelectorAll("[data-missing-transform]").length === count, view.missing);
  else await page.waitForFunction((count) => Number(document.querySelector("[data-scene]")?.dataset.items) >= count, view.items ?? 1);
  results.views[view.name] = await state();
  if (view.isPictured) {
    await page.screenshot({ path: `${pictures}/scene-${view.name}.png` });
    await page.getByRole("button", { name: "Topics and settings" }).click();
    await checkPage(page, `scene-${view.name}`);
  }
  if (view.hasSettings) {
    await page.locator("[data-setting=frame]").selectOption("base");
    await page.locator("[data-scene][data-fixed-frame=base]").waitFor();
    results.address = page.url();
    const canvas = page.locator("[data-scene] canvas");
    const before = await canvas.screenshot();
    await canvas.focus();
    await page.keyboard.press("Shift+ArrowLeft");
    await page.keyboard.press("Shift+ArrowUp");
    results.hasTurned = false;
    for (let number = 0; !results.hasTurned && number < 50; number += 1) {
      await page.waitForTimeout(100);
      results.hasTurned = !before.equals(await canvas.screenshot());
    }
    results.time = await page.locator("[data-scene-topic]").first().getAttribute("data-log-time");
    await page.getByRole("checkbox", { name: view.series[0] }).uncheck();
    await page.locator("[data-drawn-points='0']").waitFor();
  }
}
await showLate(JSON.parse(late));
await printResults();
