// What a person does who looks into recordings: opens the page of a file, sees a picture, goes on, plots, keeps the values.
// Prints as JSON what was seen. Arguments: the folder with playwright-core, the browser, a link that signs in, the
// server's address, the ids of a whole MCAP, a bag and a cut MCAP.
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { isOfTheMachine } from "./complaints.mjs";

const [web, executablePath, link, address, mcap, bag, cut] = process.argv.slice(2);
const { chromium } = createRequire(`${web}/package.json`)("playwright-core");
const PATIENCE_MS = 60_000;

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await (await browser.newContext({ acceptDownloads: true })).newPage();
page.setDefaultTimeout(PATIENCE_MS);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");

const complaints = [];
page.on("console", (message) => {
  if (["error", "warning"].includes(message.type()) && !isOfTheMachine(message.text())) complaints.push(message.text());
});
page.on("pageerror", (error) => complaints.push(error.message));

const picture = page.locator("[data-image-viewer]");
const logTime = () => picture.getAttribute("data-log-time");

/** The grey values of the picture in sight, in base64, with its size. */
async function grayPicture() {
  return page.locator("[data-image-viewer] canvas").evaluate((canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    const grey = Uint8Array.from({ length: data.length / 4 }, (_, at) => data[at * 4 + 1]);
    let text = "";
    for (const each of grey) text += String.fromCharCode(each);
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

async function curve(fileId, query) {
  await page.goto(`${address}/files/${fileId}?${query}`);
  await page.locator("[data-plot-viewer][data-messages]").waitFor();
  const asks = page.locator("[data-partial]");
  const asked = (await asks.count()) > 0 ? await asks.innerText() : null;
  if (asked !== null) {
    await asks.getByRole("button").click();
    await asks.waitFor({ state: "detached" });
    await page.locator("[data-plot-viewer][data-messages]").waitFor();
  }
  const label = await page.locator("[data-plot-viewer] [role=img]").getAttribute("aria-label");
  await page.getByRole("button", { name: "Show values" }).click();
  const cell = await page.locator("[data-plot-viewer] tbody td").first().textContent();
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Save as CSV" }).click()]);
  return { asked, label, cell, csv: await readFile(await download.path(), "utf8") };
}

const result = { mcap: await firstPicture(mcap) };
result.next = await press("ArrowRight");
result.second = await press("Shift+ArrowRight");
await page.waitForURL((url) => Number(url.searchParams.get("t")) > 1); // once it rests there
result.address = page.url();
result.bag = await firstPicture(bag);
result.imu = await curve(mcap, "topic=/imu/data");
result.odom = await curve(bag, "topic=/odom&field=pose.pose.position.x&field=pose.pose.position.y");
result.cut = await firstPicture(cut);
result.cut.told = await page.locator("[data-beginning]").innerText();
result.complaints = complaints;
await browser.close();
process.stdout.write(JSON.stringify(result));
