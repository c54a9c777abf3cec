// Events in a real browser: adds a moment and a span by keys in the viewer, sees both in the list and above the time axis,
// edits one while another window shows it, makes an event of a finding, is refused an outdated change, finds them by
// `event:`, opens a link to one, cuts and deletes; a person who may only read, and one with a share link. Prints the results as JSON. Arguments:
// the folder with playwright-core and axe-core, the browser, a sign-in link, the server's address, as JSON an invitation of
// the reader, a share link, and the ids of the mission and a file, the folder for screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, input, pictures] = process.argv.slice(2);
const { invitation, mission, file, share } = JSON.parse(input);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let expectsErrors = false;
const { page, context } = await openPage(() => expectsErrors);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
const form = page.getByRole("dialog");
const strip = page.locator("[data-marks]");
const rows = (of) => of.locator("[data-events-table] [data-index]");
const row = (of, name) => rows(of).filter({ hasText: name });
const headTime = (of) => of.locator("[data-transport]").getAttribute("data-time");
const marked = (of, count) => of.locator(`[data-marks][data-count="${count}"]`).waitFor();
const save = async () => {
  await page.locator("[data-save-event]").click();
  await form.waitFor({ state: "hidden" });
};
const seekTo = async (of, share) => {
  const slider = of.getByRole("slider", { name: "Time" });
  await slider.focus(); // it has the focus after a drag
  await slider.evaluate((input, at) => {
    input.value = String(Math.round(at * Number(input.max)));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }, share);
};

// A moment by a key; the list and the marks show it, and so does another window without a reload.
await page.goto(`${address}/missions/${mission}/view`);
await marked(page, 1); // the finding of a run
const other = await context.newPage();
await other.goto(`${address}/missions/${mission}?tab=events`);
await other.getByRole("heading", { name: "No events yet" }).waitFor();
await page.bringToFront();
await page.getByRole("slider", { name: "Time" }).click();
await seekTo(page, 0.25);
results.momentAt = await headTime(page);
await page.keyboard.press("e");
await form.getByLabel("Name").fill("stumble");
await form.getByLabel("Labels").fill("left, slow");
await form.getByLabel("Red").check();
await form.getByLabel("Note").fill("<img src=x onerror=alert(1)> on ice");
await checkPage(page, "event-form");
await form.getByLabel("Name").press("Enter");
await form.waitFor({ state: "hidden" });
await marked(page, 2);
await page.locator("[data-toggle-events]").click();
results.moment = await row(page, "stumble").innerText();

// A span by two keys.
await seekTo(page, 0.5);
results.spanFrom = await headTime(page);
await page.keyboard.press("]");
results.noBegin = await page.getByRole("log").innerText();
await page.keyboard.press("[");
await page.locator("[data-begun]").waitFor();
await seekTo(page, 0.75);
results.spanTo = await headTime(page);
await page.keyboard.press("]");
await form.getByLabel("Name").fill("trot");
await save();
await marked(page, 3);
await checkPage(page, "viewer-events");

// A span also begins by a button.
await page.locator("[data-span]").click();
results.spanButton = await page.locator("[data-span]").innerText();
await page.locator("[data-begun]").getByRole("button", { name: "Discard" }).click();
await page.locator("[data-begun]").waitFor({ state: "detached" });

// The window in the background follows when it is seen again.
await other.bringToFront();
await row(other, "trot").waitFor();
results.otherRows = (await rows(other).allInnerTexts()).map((text) => text.split("\n")[0].trim());

// Marks jump: by a click on the bar of the span, by keys, and by a row.
await page.bringToFront();
const box = await strip.boundingBox();
await page.mouse.move(box.x + box.width * 0.6, box.y + 4);
results.hint = await strip.locator(".hint").innerText();
const moved = async (before) => {
  await page.waitForFunction((time) => document.querySelector("[data-transport]").dataset.time !== time, before);
  return headTime(page);
};
const beforeClick = await headTime(page);
await page.mouse.click(box.x + box.width * 0.6, box.y + 4);
results.clicked = await moved(beforeClick);
await page.locator("main h1").click();
await page.keyboard.press("M");
results.previous = await moved(results.clicked);
await row(page, "trot").locator("[data-row-link]").click();
results.byRow = await moved(results.previous);

// A finding becomes an event, once.
await page.locator("[data-timed-findings]").getByRole("button").first().click();
results.ofFinding = [await form.getByLabel("Name").inputValue(), await form.getByLabel("Note").inputValue()];
await save();
await page.locator("[data-timed-findings]").waitFor({ state: "detached" });
await marked(page, 3);

// An edit is live in the other window; a change of an outdated version is refused.
await other.bringToFront();
await row(other, "imu.gap").waitFor(); // it moves the other rows
await row(other, "stumble").getByRole("button", { name: "Edit stumble" }).click();
await page.bringToFront();
await row(page, "stumble").getByRole("button", { name: "Edit stumble" }).click();
await form.getByLabel("Name").fill("slip");
await form.getByLabel("Duration").fill("0.5");
await save();
await row(page, "slip").waitFor();
await other.bringToFront();
await row(other, "slip").waitFor();
const otherForm = other.getByRole("dialog");
await otherForm.getByLabel("Note").fill("Another note");
expectsErrors = true;
await other.locator("[data-save-event]").click();
await otherForm.getByRole("alert").first().waitFor();
results.conflict = await otherForm.getByRole("alert").first().innerText();
expectsErrors = false;
await otherForm.getByRole("button", { name: "Cancel" }).click();
await checkPage(other, "mission-events");
results.missionRows = (await rows(other).allInnerTexts()).map((text) => text.split("\n")[0].trim());

// Searches find events, and lead to their time.
await page.bringToFront();
await page.goto(`${address}/search?q=event:trot&tab=missions`);
await page.locator("[data-event-link]").waitFor();
await checkPage(page, "search-events");
await page.locator("[data-event-link]").click();
await page.locator("[data-transport]").waitFor();
results.fromSearch = await headTime(page);
await page.goto(`${address}/search?q=event:trot`);
await page.locator("[data-event-link]").first().waitFor();
results.fileLink = await page.locator("[data-event-link]").first().getAttribute("href");
await page.goto(`${address}/search?q=event:nothing`);
await page.getByRole("heading", { name: "No results" }).waitFor();

// Cutting: the commands, and the form of the browser with the range.
await page.goto(`${address}/missions/${mission}?tab=events`);
await row(page, "trot").getByRole("button", { name: "Cut trot" }).click();
results.commands = (await page.locator("[data-event-cut] pre").allInnerTexts()).map((text) => text.trim());
await checkPage(page, "event-cut");
await page.getByRole("link", { name: "Cut in the browser" }).click();
const times = page.locator("[data-slice]");
await times.locator("[data-from]").waitFor();
results.cutRange = [await times.locator("[data-from]").inputValue(), await times.locator("[data-to]").inputValue()];

// A reader sees events, and no buttons that change them.
const { page: reader } = await openPage();
await reader.goto(invitation);
await reader.getByLabel(/password/i).fill("a long enough password");
await reader.getByRole("button", { name: "Create my account" }).click();
await reader.waitForURL((url) => url.pathname === "/");
await reader.goto(`${address}/missions/${mission}?tab=events`);
await row(reader, "slip").waitFor();
results.readerButtons = (await row(reader, "slip").getByRole("button").evaluateAll((all) => all.map(({ title }) => title))).filter((title) => title !== "");
results.readerAdds = await reader.locator("[data-add-event]").count();
await reader.goto(`${address}/files/${file}/view?events=1`);
await row(reader, "slip").waitFor();
await reader.keyboard.press("e");
results.readerForms = await reader.getByRole("dialog").count();
results.readerAdds += await reader.locator("[data-add-event]").count();

// Somebody with a link to the mission sees its events, which go to their time, and no people, findings or buttons.
const { page: guest } = await openPage();
await guest.goto(`${address}/s/view?events=1${new URL(share).hash}`);
await row(guest, "slip").waitFor();
await guest.keyboard.press("e");
await checkPage(guest, "viewer-shared-events");
await row(guest, "slip").click();
await guest.waitForURL((url) => url.searchParams.has("t") && url.hash === new URL(share).hash);
results.guest = {
  forms: await guest.getByRole("dialog").count(),
  adds: await guest.locator("[data-add-event], [data-span]").count(),
  buttons: (await row(guest, "slip").getByRole("button").evaluateAll((all) => all.map(({ title }) => title))).filter((title) => title !== ""),
  time: await headTime(guest),
};

// Deleting asks first; the reader's page follows.
await page.goto(`${address}/missions/${mission}?tab=events`);
await row(page, "slip").getByRole("button", { name: "Delete slip" }).click();
await page.getByRole("dialog").getByRole("button", { name: "Delete event" }).click();
await row(page, "slip").waitFor({ state: "detached" });
await reader.bringToFront();
await row(reader, "slip").waitFor({ state: "detached" });
results.left = (await rows(reader).allInnerTexts()).map((text) => text.split("\n")[0].trim());
await printResults();
