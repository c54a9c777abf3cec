// The viewer over a slow line: which ranges it requests until the first picture and cloud, and after a jump. Prints the
// results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the server's
// address, the folder for screenshots, and as JSON: the ids of the mission and of a file, panels as the address writes
// them (an image, a cloud, a plot, and others out of sight), times, and the parts of the file that they need at first.
import { setTimeout as pause } from "node:timers/promises";
import { openBrowser } from "./browsing.mjs";
import { slowStore } from "./slow_store.mjs";

const [web, executablePath, link, address, pictures, request] = process.argv.slice(2);
const { mission, file, panels, times, needed, line } = JSON.parse(request);
const { results, openPage, printResults } = await openBrowser(web, executablePath, pictures);
const store = await slowStore(line);
const { page } = await openPage(() => false, { proxy: { server: store.address, bypass: "<-loopback>" } });
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const panel = (place) => page.locator("[data-panel]").nth(place);
const POLL_MS = 20;

async function until(isTrue) {
  while (!isTrue()) await pause(POLL_MS);
}

const isNeeded = ({ path, first, last }) => path === results.preview || needed.some(([from, to]) => first >= from && last <= to);
const isShown = async (image, cloud) => {
  await panel(0).locator(`[data-image][data-log-time="${image}"]`).waitFor();
  const picture = asked();
  await panel(1).locator(`[data-scene-topic][data-log-time="${cloud}"]`).waitFor({ state: "attached" });
  return { picture, cloud: asked() };
};

/** Returns what the store was asked for until now. */
const asked = () => ({ atMs: Date.now(), ranges: structuredClone(store.ranges) });

results.preview = await page.evaluate(async (id) => new URL((await (await fetch(`/api/v1/files/${id}/preview`)).json()).url).pathname, file);
await page.goto(`${address}/missions/${mission}/view?${new URLSearchParams([...panels.map((one) => ["p", one]), ["t", times.first]])}`);
results.first = await isShown(times.firstImage, times.firstCloud);
await page.screenshot({ path: `${pictures}/slow-line.png` });

// A jump back by some seconds, while something is read that is not needed at the first time.
await until(() => store.ranges.some((range) => range.endedAtMs === null && !isNeeded(range)));
await panel(0).locator("h2").click();
results.before = asked();
for (let seconds = 0; seconds < times.jumpSeconds; seconds += 1) await page.keyboard.press("ArrowLeft");
results.second = await isShown(times.secondImage, times.secondCloud);

// What was out of sight is read once it is seen.
await panel(panels.length - 1).scrollIntoViewIfNeeded();
await panel(panels.length - 1).locator("[data-log-time]").waitFor();
results.scrolled = asked();
await printResults();
store.close();
