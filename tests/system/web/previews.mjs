// Previews: a mission with nothing but a recording, whose page shows those of a run once it ends; the gallery with its large view, by
// mouse and keys; an outdated one; and the first pictures in the lists of missions, also after their URLs expired.
// Prints the results as JSON. Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the
// server's address, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures] = process.argv.slice(2);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let isRefusing = false;
const { context, page } = await openPage(() => isRefusing);
const thumbnails = page.locator("[data-thumbnail]");
const loaded = (count, selector) =>
  page.waitForFunction(([least, css]) => [...document.querySelectorAll(css)].filter(({ naturalWidth }) => naturalWidth > 0).length >= least, [count, selector]);
const rowsLoaded = () => page.locator("main [data-index] [data-row-link]").first().waitFor();
const missionLink = (name) => page.locator("main [data-row-link]", { hasText: name }).first();

await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
await page.goto(`${address}/projects`);
await missionLink("Alps").click();
await page.locator("main [data-row-link]", { hasText: "day" }).waitFor();
const project = page.url();

// A mission without previews; a run that another window starts shows its previews without a reload.
const night = await missionLink("night").getAttribute("href");
await loaded(2, "[data-thumbnail] img");
const shownForDay = () => page.locator("[data-index]", { hasText: "day" }).locator("[data-thumbnail] img").evaluateAll((all) => all.map(({ alt }) => alt));
results.before = { project: await shownForDay() };
await page.goto(address);
await rowsLoaded();
await loaded(2, "[data-thumbnail] img");
results.before.home = await shownForDay();
await page.goto(project);
await missionLink("day").click();
const none = page.locator("[data-no-previews]");
await none.waitFor();
results.none = await none.innerText();
await checkPage(page, "mission-without-previews");
const day = page.url();
const launching = await context.newPage();
await launching.goto(`${address}${await none.getByRole("link", { name: "Run an action" }).getAttribute("href")}`);
await launching.getByLabel("Action").selectOption({ index: 1 });
await launching.getByRole("button", { name: /^Run$|^Run on \d/ }).click();
await launching.locator('[data-state="done"]').waitFor();
await page.bringToFront();
await page.locator("[data-previews]").waitFor();
await launching.close();

// The gallery: the first ones, then all.
const tiles = page.locator("[data-picture]");
await loaded(4, "[data-picture] img");
await page.locator("[data-previews] figure svg").waitFor();
results.gallery = {
  first: (await tiles.allInnerTexts()).map((text) => text.trim()),
  others: await page.locator("[data-previews] h3").allInnerTexts(),
  outdated: await page.locator("[data-previews]").getByText("Outdated").count(),
};
await checkPage(page, "mission-previews");
await page.getByRole("button", { name: "Show all 9 previews" }).click();
await loaded(7, "[data-picture] img");
results.gallery.all = await tiles.allInnerTexts();

// The large view: the next and previous by keys and buttons, and back to the tile.
const dialog = page.getByRole("dialog");
const title = async () => {
  await page.waitForFunction(() => document.querySelector("dialog[open] img")?.naturalWidth > 0);
  return dialog.locator("h2").innerText();
};
await tiles.first().click();
results.large = { titles: [await title()] };
await checkPage(page, "picture");
for (const key of ["ArrowRight", "ArrowRight", "ArrowLeft"]) {
  await page.keyboard.press(key);
  results.large.titles.push(await title());
}
await page.keyboard.press("Escape");
await dialog.waitFor({ state: "hidden" });
await tiles.nth(5).focus();
await page.keyboard.press("Enter");
await dialog.getByRole("button", { name: "Next" }).click();
results.large.titles.push(await title());
results.large.place = await dialog.getByRole("status").innerText();
results.large.isLastDisabled = await dialog.getByRole("button", { name: "Next" }).isDisabled();
await page.keyboard.press("Escape");
await dialog.waitFor({ state: "hidden" });
results.large.focusedAfter = (await page.evaluate(() => document.activeElement?.textContent ?? "")).trim();
await page.goto(`${address}${night}`);
await page.locator("[data-previews]").waitFor();
results.outdated = await page.locator("[data-previews] .chip").allInnerTexts();
await checkPage(page, "mission-outdated");

// The lists.
const list = async (path, name) => {
  await page.goto(path);
  await rowsLoaded();
  const places = () => page.locator("main [data-index] [data-row-link] .ellipsis:first-child").evaluateAll((all) => all.map((entry) => `${entry.textContent} ${entry.getBoundingClientRect().x} ${entry.getBoundingClientRect().y}`));
  const before = await places();
  await loaded(2, "[data-thumbnail] img");
  const after = new Set(await places());
  results.lists[name] = {
    alts: await thumbnails.locator("img").evaluateAll((all) => all.map(({ alt }) => alt)),
    heights: await page.locator("main [data-index]").evaluateAll((all) => all.map((row) => Math.round(row.getBoundingClientRect().height))),
    boxes: await thumbnails.evaluateAll((all) => all.map((box) => [box.offsetWidth, box.offsetHeight])),
    moved: before.filter((place) => !after.has(place)),
  };
  await checkPage(page, `list-${name}`);
};
results.lists = {};
await list(`${project}?sort=name`, "project");
await page.evaluate(() => window.scrollTo(0, document.body.scrollHeight));
await page.locator("main [data-row-link]", { hasText: "planned 69" }).waitFor();
await page.evaluate(() => window.scrollTo(0, 0));
await loaded(2, "[data-thumbnail] img");
results.lists.far = {
  rows: await page.locator("main [data-index]").count(),
  alts: await thumbnails.locator("img").evaluateAll((all) => all.map(({ alt }) => alt)),
};
await list(`${address}/search?tab=missions&q=topic:/imu/data`, "search");
await list(address, "home");

// The store refuses the first URL, as if it had expired.
let requests = 0;
isRefusing = true;
await page.route("**/api/v1/missions/pictures", (route) => {
  requests += 1;
  return route.continue();
});
let isFirst = true;
await page.route(/X-Amz-Signature/, (route) => {
  if (!isFirst) return route.continue();
  isFirst = false;
  return route.fulfill({ status: 403, headers: { "access-control-allow-origin": "*" } });
});
await page.goto(`${address}/search?tab=missions&q=night`);
await rowsLoaded();
await loaded(1, "[data-thumbnail] img");
results.renewed = { requests, pictures: await thumbnails.count() };
results.day = day;
await printResults();
