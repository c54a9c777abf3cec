// Takes the screenshots of the README and the tour: a mission, a search, the preview of a recording, checks,
// and the viewer of a mission.
// Prints an empty object. Arguments: the folder with playwright-core, the browser, a sign-in link, the server's address,
// the folder for screenshots, the ids of a mission, of a recording and of a project, a search query.
import { launchBrowser } from "./chromium.mjs";

const [web, executablePath, link, address, pictures, mission, recording, project, query] = process.argv.slice(2);
const TIMEOUT_MS = 60_000;
/** Until all panels have drawn what they read. */
const SETTLED_MS = 6_000;

const browser = await launchBrowser(web, executablePath);
const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, reducedMotion: "reduce", colorScheme: "light" });
const page = await context.newPage();
page.setDefaultTimeout(TIMEOUT_MS);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

async function takeScreenshot(name, path, ready, prepare = () => undefined) {
  await page.goto(`${address}${path}`);
  await page.locator(ready).first().waitFor();
  await page.waitForFunction(() => document.querySelector("main .skeleton, main [aria-busy=true]") === null);
  await page.evaluate(() => document.fonts.ready);
  await prepare();
  await page.screenshot({ path: `${pictures}/readme-${name}.png` });
}

await takeScreenshot("mission", `/missions/${mission}`, "[data-lanes]");
await takeScreenshot("search", `/search?q=${encodeURIComponent(query)}`, "[data-results] [data-row-link]");
const curves = new URLSearchParams([["topic", "/odom"], ["field", "pose.pose.position.x"], ["field", "pose.pose.position.y"]]);
await takeScreenshot("preview", `/files/${recording}?${curves}`, "[data-plot-viewer][data-messages]");
await takeScreenshot("checks", `/missions/${mission}?tab=checks`, "[data-checks] [role=row][data-index]");
await takeScreenshot("matrix", `/projects/${project}?tab=checks`, "[data-matrix] [data-status=error]", async () => {
  await page.getByRole("gridcell", { name: "topic.gap: Error" }).focus();
  await page.locator("[data-explained]").getByText("longest gap").waitFor();
  await page.locator("[data-explained]").scrollIntoViewIfNeeded();
});
await takeScreenshot("viewer", `/missions/${mission}/view`, "[data-panel] [data-log-time]", async () => {
  await page.locator("[data-transport] input[type=range]").evaluate((scrubber) => {
    scrubber.value = String(Number(scrubber.max) * 0.4);
    scrubber.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await page.waitForTimeout(SETTLED_MS);
});
await browser.close();
process.stdout.write("{}");
