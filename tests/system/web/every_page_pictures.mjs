// The pictures that README and tour show: a mission, a search, a first look at a recording. Prints nothing worth knowing.
// Arguments: the folder with playwright-core, the browser, a link that signs in, the server's address, where pictures go,
// the ids of a mission and of a recording, what is searched for.
import { createRequire } from "node:module";

const [web, executablePath, link, address, pictures, mission, recording, query] = process.argv.slice(2);
const { chromium } = createRequire(`${web}/package.json`)("playwright-core");
const PATIENCE_MS = 60_000;

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, reducedMotion: "reduce", colorScheme: "light" });
const page = await context.newPage();
page.setDefaultTimeout(PATIENCE_MS);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

async function take(name, path, ready) {
  await page.goto(`${address}${path}`);
  await page.locator(ready).first().waitFor();
  await page.waitForFunction(() => document.querySelector("main .skeleton, main [aria-busy=true]") === null);
  await page.evaluate(() => document.fonts.ready);
  await page.screenshot({ path: `${pictures}/readme-${name}.png` });
}

await take("mission", `/missions/${mission}`, "[data-lanes]");
await take("search", `/search?q=${encodeURIComponent(query)}`, "[data-results] [data-row-link]");
const curves = new URLSearchParams([["topic", "/odom"], ["field", "pose.pose.position.x"], ["field", "pose.pose.position.y"]]);
await take("preview", `/files/${recording}?${curves}`, "[data-plot-viewer][data-messages]");
await browser.close();
process.stdout.write("{}");
