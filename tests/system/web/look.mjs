// Previews of recordings: opens the page of a file, steps through its pictures, plots a topic, and saves the values.
// Prints the results as JSON. Arguments: the folder with playwright-core, the browser, a sign-in link, the server's
// address, the ids of an intact MCAP, a bag, a truncated MCAP and a rosbag2 database.
import { readFile } from "node:fs/promises";
import { launchBrowser } from "./chromium.mjs";
import { isEnvironmentError } from "./console_errors.mjs";

const [web, executablePath, link, address, mcap, bag, cut, db3] = process.argv.slice(2);
const TIMEOUT_MS = 60_000;

const browser = await launchBrowser(web, executablePath);
const page = await (await browser.newContext({ acceptDownloads: true })).newPage();
page.setDefaultTimeout(TIMEOUT_MS);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const consoleErrors = [];
page.on("console", (message) => {
  if (["error", "warning"].includes(message.type()) && !isEnvironmentError(message.text())) consoleErrors.push(message.text());
});
page.on("pageerror", (error) => consoleErrors.push(error.message));

const picture = page.locator("[data-image-viewer]");
const logTime = () => picture.getAttribute("data-log-time");

/** Returns the grey values of the displayed picture in base64, and its size. */
async function grayPicture() {
  return page.locator("[data-image-viewer] canvas").evaluate((canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    const grey = Uint8Array.from({ length: data.length / 4 }, (_, pixel) => data[pixel * 4 + 1]);
    let text = "";
    for (const value of grey) text += String.fromCharCode(value);
    return { width: canvas.width, height: canvas.height, grey: btoa(text) };
  });
}

async function firstPicture(fileId) {
  const began = performance.now();
  await page.goto(`${address}/files/${fileId}`);
  await page.locator("[data-log-time]").waitFor();
  const milliseconds = performance.now() - began;
  return { ...(await grayPicture()), milliseconds, logTime: await logTime(), bytesRead: await bytesRead() };
}

async function bytesRead() {
  return Number(await page.locator("[data-bytes-read]").getAttribute("data-bytes"));
}

async function press(key) {
  const before = await logTime();
  await page.locator("[data-image-viewer] input[type=range]").press(key);
  await page.waitForFunction((time) => document.querySelector("[data-log-time]")?.getAttribute("data-log-time") !== time, before);
  return { ...(await grayPicture()), logTime: await logTime() };
}

async function plot(fileId, query) {
  await page.goto(`${address}/files/${fileId}?${query}`);
  await page.locator("[data-plot-viewer][data-messages]").waitFor();
  const notice = page.locator("[data-partial]");
  const partialNotice = (await notice.count()) > 0 ? await notice.innerText() : null;
  if (partialNotice !== null) {
    await notice.getByRole("button").click();
    await notice.waitFor({ state: "detached" });
    await page.locator("[data-plot-viewer][data-messages]").waitFor();
  }
  const label = await page.locator("[data-plot-viewer] [role=img]").getAttribute("aria-label");
  await page.getByRole("button", { name: "Show values" }).click();
  const cell = await page.locator("[data-plot-viewer] tbody td").first().textContent();
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Save as CSV" }).click()]);
  return { partialNotice, label, cell, csv: await readFile(await download.path(), "utf8") };
}

const results = { mcap: await firstPicture(mcap) };
results.next = await press("ArrowRight");
results.second = await press("Shift+ArrowRight");
await page.waitForURL((url) => Number(url.searchParams.get("t")) > 1); // the address is updated after the last step
results.address = page.url();
results.bag = await firstPicture(bag);
results.imu = await plot(mcap, "topic=/imu/data");
results.odom = await plot(bag, "topic=/odom&field=pose.pose.position.x&field=pose.pose.position.y");
results.cut = await firstPicture(cut);
results.cut.notice = await page.locator("[data-beginning]").innerText();
results.db3 = await firstPicture(db3);
results.db3Next = await press("ArrowRight");
results.db3Odom = await plot(db3, "topic=/odom&field=pose.pose.position.x&field=pose.pose.position.y");
results.db3CanBeSliced = (await page.getByRole("button", { name: "Download selection" }).count()) > 0;
results.consoleErrors = consoleErrors;
await browser.close();
process.stdout.write(JSON.stringify(results));
