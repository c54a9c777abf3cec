// The viewer in trouble: a recording of 10,000 topics, a jump of ten years, addresses that expire, and a
// recording that is deleted while it is watched. Prints the results as JSON. Arguments: the folder with playwright-core
// and axe-core, the browser, a sign-in link, the server's address, the folder for screenshots, and as JSON: the ids of
// the mission and of its files, panels as the address writes them, times, and how long an address is valid.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, pictures, request] = process.argv.slice(2);
const { mission, files, panels, times, addressSeconds } = JSON.parse(request);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let areErrorsExpected = false;
const { context, page } = await openPage(() => areErrorsExpected);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const panel = (place) => page.locator("[data-panel]").nth(place);
const logTime = (place) => panel(place).locator("[data-log-time]").getAttribute("data-log-time");
const leaves = (place) => panel(place).locator("[data-value]").evaluateAll((all) => Object.fromEntries(all.map((leaf) => [leaf.dataset.value, leaf.textContent])));
const playHead = () => page.locator("[data-transport]").getAttribute("data-time");
const withPanels = (base, kinds, time) => `${base}?${[...kinds.map((kind) => ["p", panels[kind]]), ["t", time]].map(([name, value]) => `${name}=${encodeURIComponent(value)}`).join("&")}`;
const viewed = (kinds, time) => withPanels(`${address}/missions/${mission}/view`, kinds, time);

/** Waits until a panel shows the message of this time. */
const showsTime = (place, time) =>
  page.waitForFunction(([at, expected]) => document.querySelectorAll("[data-panel]")[at]?.querySelector("[data-log-time]")?.getAttribute("data-log-time") === expected, [place, time]);

// The default layout, and one topic of ten thousand.
await page.goto(`${address}/files/${files["many.mcap"]}/view`);
await panel(0).locator("[data-log-time]").waitFor();
results.defaultPanels = await page.locator("[data-panel]").count();
await page.getByRole("button", { name: "Add panel" }).click();
const dialog = page.getByRole("dialog");
await dialog.locator("li").first().waitFor();
results.listedTopics = await dialog.locator("li").count();
await checkPage(page, "viewer-many-topics");
await dialog.getByRole("searchbox").fill("sensor/09998");
await page.waitForFunction(() => document.querySelectorAll("dialog li").length === 1);
await dialog.getByRole("button", { name: /^Raw messages/ }).click();
const added = page.locator("[data-panel]").nth(results.defaultPanels);
await added.locator("h2").click();
await page.keyboard.press("End"); // each topic has one message, at a time of its own
await added.locator("[data-value]").first().waitFor();
results.addedTopic = await added.locator("[data-value]").allTextContents();

// A recording whose first messages are ten years older than the others.
await page.goto(viewed(["yearsRaw", "yearsPlot"], times.first));
await showsTime(0, times.first);
await panel(1).locator("[data-plot][data-messages]").waitFor();
results.years = { messages: await panel(1).locator("[data-plot]").getAttribute("data-messages"), first: await leaves(0) };
await panel(0).locator("h2").click();
await page.keyboard.press(".");
await showsTime(0, times.second);
results.years.second = await leaves(0);
await page.keyboard.press("Home");
results.years.home = await playHead();
await page.keyboard.press("End");
results.years.end = await playHead();
await checkPage(page, "viewer-ten-years");

// Addresses are valid for some seconds, and the browser believes for an hour.
const renewals = [];
await page.route("**/api/v1/files/download", async (route) => {
  const response = await route.fetch();
  const answer = await response.json();
  for (const item of answer.items ?? []) item.expires_at = new Date(Date.now() + 3_600_000).toISOString();
  renewals.push(Date.now());
  await route.fulfill({ response, json: answer });
});
const refusals = [];
page.on("response", (response) => response.status() === 403 && refusals.push(response.url()));
areErrorsExpected = true; // the store refuses an address that has expired
await page.goto(viewed(["image"], times.image));
await panel(0).locator("[data-log-time]").waitFor();
results.expired = { renewalsAtFirst: renewals.length };
await page.waitForTimeout((addressSeconds + 2) * 1000);
await panel(0).locator("h2").click();
await page.keyboard.press("End");
await page.waitForFunction((time) => document.querySelector("[data-log-time]")?.getAttribute("data-log-time") === time, times.lastImage);
results.expired = { ...results.expired, renewals: renewals.length, refusals: refusals.length, failures: await page.locator("[data-read-failure]").count() };

// Deleted while it is watched, by somebody else: this panel says so, and the other one goes on.
await page.goto(viewed(["image", "yearsRaw"], times.image));
await panel(0).locator("[data-log-time]").waitFor();
await panel(1).locator("[data-no-message], [data-log-time]").first().waitFor();
results.deleted = { status: (await context.request.delete(`${address}/api/v1/files/${files["drive.mcap"]}`, { headers: { Origin: address } })).status() };
await page.waitForTimeout((addressSeconds + 2) * 1000);
await panel(0).locator("h2").click();
await page.keyboard.press("End");
await panel(0).locator("[data-read-failure]").waitFor();
results.deleted.sentence = await panel(0).locator("[data-read-failure]").innerText();
await showsTime(1, times.last);
results.deleted.other = await leaves(1);
await checkPage(page, "viewer-deleted");
await printResults();
