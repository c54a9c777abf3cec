// Changes: resumes an upload of another machine, renames a mission, writes notes, shares a file and revokes the link, moves
// and verifies a file, deletes and restores objects; and the home page of a new user. Prints the results as JSON.
// Arguments: the folder with playwright-core and axe-core, the browser, a sign-in link, the server's address, an
// invitation for a new user, the folder of the unfinished upload, as JSON the ids of missions and files, the folder for
// screenshots.
import { openBrowser } from "./browsing.mjs";

const [web, executablePath, link, address, invitation, half, input, pictures] = process.argv.slice(2);
const { ridge, night, drive } = JSON.parse(input);
const { results, openPage, checkPage, printResults } = await openBrowser(web, executablePath, pictures);
let expectsErrors = false;
const { page } = await openPage(() => expectsErrors);
await page.goto(link);
await page.waitForURL((url) => url.pathname === "/");
const toast = (text) => page.getByRole("log").locator("> div").filter({ hasText: text }).last();
const dialog = (name) => page.getByRole("dialog", { name });

// An unfinished upload of another machine: the home page lists it and links to the page that resumes it.
const unfinished = page.locator("[data-unfinished]");
await unfinished.waitFor();
results.unfinished = await unfinished.innerText();
await checkPage(page, "home-unfinished");
await unfinished.getByRole("link", { name: "Resume" }).click();
await page.waitForURL((url) => url.pathname === "/upload" && url.searchParams.get("mission") === night);
const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Choose a folder" }).click()]);
await chooser.setFiles(half);
await page.getByRole("radio", { checked: true }).and(page.locator("[value=contents]")).waitFor();
await page.getByLabel("Mission").and(page.locator(`:has(option:checked[value="${night}"])`)).waitFor();
results.destination = await page.locator("form").getByRole("combobox").evaluateAll((boxes) => boxes.map((box) => box.selectedOptions[0].label));
await page.getByRole("button", { name: /^Upload \d+ file/ }).click();
await page.locator("[data-phase=over]").waitFor();
results.finished = await page.locator("[data-phase=over]").innerText();
await page.getByRole("link", { name: "Home" }).first().click();
await page.locator("[data-recent] [data-row-link]").first().waitFor();
await unfinished.waitFor({ state: "detached" });

// Renaming: a taken name is refused with an explanation, then a free one is accepted.
await page.locator("[data-recent] [data-row-link]").filter({ hasText: "ridge" }).click();
await page.getByRole("heading", { level: 1, name: "ridge" }).waitFor();
await page.getByRole("button", { name: "Rename" }).click();
await dialog("Rename mission").getByLabel("New name").fill("night");
expectsErrors = true;
await dialog("Rename mission").getByRole("button", { name: "Save" }).click();
const takenName = dialog("Rename mission").getByText("There is already");
await takenName.waitFor();
results.nameConflict = await takenName.innerText();
await checkPage(page, "mission-rename-refused");
expectsErrors = false;
await dialog("Rename mission").getByLabel("New name").fill("north ridge");
await dialog("Rename mission").getByRole("button", { name: "Save" }).click();
await page.getByRole("heading", { level: 1, name: "north ridge" }).waitFor();

// Marks the mission as complete, incomplete, and complete again.
await page.getByRole("button", { name: "Mark as complete" }).click();
await page.getByRole("button", { name: "Mark as incomplete" }).click();
await page.getByRole("button", { name: "Mark as complete" }).waitFor();
await page.reload();
await page.getByRole("button", { name: "Mark as complete" }).click();
await page.getByRole("button", { name: "Mark as incomplete" }).waitFor();

// Notes: Escape discards changes, Ctrl+Enter saves them; markup in them is shown as text.
const notes = page.locator("[data-notes]");
await notes.getByRole("button", { name: "Add notes" }).click();
await notes.getByRole("textbox").fill("thought better of");
await notes.getByRole("textbox").press("Escape");
await notes.getByText("No notes.").waitFor();
await notes.getByRole("button", { name: "Add notes" }).click();
await notes.getByRole("textbox").fill("<img src=x onerror=alert(1)> **kept**\nsecond line");
await notes.getByRole("textbox").press("Control+Enter");
await notes.getByText("<img src=x onerror=alert(1)> **kept**").waitFor();
results.notesElements = await notes.locator("img, strong").count();

// A link to one file, opened by an anonymous visitor, then revoked.
await page.getByRole("checkbox", { name: "Select drive.mcap" }).check();
await page.getByRole("button", { name: "Share selected files" }).click();
await dialog("Share with a link").getByLabel("Purpose or recipient").fill("reviewers");
await dialog("Share with a link").getByRole("button", { name: "Create link" }).click();
await dialog("Share with a link").locator("[data-secret]").waitFor();
await checkPage(page, "mission-shared");
const shared = (await page.locator("[data-secret] pre").innerText()).trim();
await page.getByRole("button", { name: "I saved it" }).click();
const { page: anonymous } = await openPage(() => expectsErrors);
await anonymous.goto(shared);
await anonymous.locator("#files tr").first().waitFor();
results.shared = await anonymous.locator("#files tr").allInnerTexts();
await page.getByRole("navigation", { name: "Views of the mission" }).getByRole("link", { name: "Access and links" }).click();
const shares = page.locator("[data-shares]");
await shares.getByText("reviewers").waitFor();
results.link = await shares.getByRole("listitem").innerText();
await shares.getByRole("button", { name: "Revoke" }).click();
await dialog("Revoke this link?").getByRole("button", { name: "Revoke" }).click();
await shares.getByText("revoked", { exact: true }).waitFor();
await checkPage(page, "mission-link-ended");
expectsErrors = true;
await anonymous.reload();
await anonymous.locator("#message:not([hidden])").waitFor();
results.revoked = await anonymous.locator("#message").innerText();
expectsErrors = false;
await anonymous.close();

// A file: verifies it again, moves it to another mission, deletes and restores it.
await page.goto(`${address}/files/${drive}`);
const verifiedAt = page.getByRole("complementary", { name: "About this file" }).getByText(/^Verified/).locator("time");
const verify = page.getByRole("button", { name: "Verify now" });
await verify.click();
await page.waitForFunction(() => [...document.querySelectorAll("aside button")].every((button) => button.ariaDisabled !== "true"));
await verifiedAt.waitFor();
const before = await verifiedAt.getAttribute("datetime");
await verify.click();
await page.waitForFunction((old) => [...document.querySelectorAll("aside time")].every((time) => time.dateTime !== old), before);
results.verified = { before, after: await verifiedAt.getAttribute("datetime") };

await page.getByRole("button", { name: "Move" }).click();
await dialog("Move to another mission").getByLabel("Search missions by name").fill("nig");
await dialog("Move to another mission").getByLabel("Mission", { exact: true }).selectOption({ label: "Alps / night" });
await checkPage(page, "file-move");
await dialog("Move to another mission").getByRole("button", { name: "Move" }).click();
await toast("Moved to night.").waitFor();
await page.getByRole("navigation", { name: "Breadcrumbs" }).getByRole("link", { name: "night" }).click();
await page.waitForURL((url) => url.pathname === `/missions/${night}`);
await page.getByRole("row").filter({ hasText: "drive.mcap" }).waitFor();
await page.getByRole("row").filter({ hasText: "drive.mcap" }).getByRole("link").first().click();
await page.waitForURL((url) => url.pathname === `/files/${drive}`);
await page.getByRole("button", { name: "Delete" }).click();
await dialog("Delete this file?").getByRole("button", { name: "Delete" }).click();
await page.waitForURL((url) => url.pathname === `/missions/${night}`);
await page.getByRole("row").filter({ hasText: "drive.mcap" }).waitFor({ state: "detached" });
await toast("drive.mcap moved to the trash.").getByRole("button", { name: "Undo" }).click();
await page.waitForURL((url) => url.pathname === `/files/${drive}`);
await page.getByRole("heading", { level: 1, name: "drive.mcap" }).waitFor();

// A mission: deletes it and undoes that, deletes it again and restores it from the trash.
async function removeRidge() {
  await page.goto(`${address}/missions/${ridge}`);
  await page.getByRole("button", { name: "Delete" }).click();
  await dialog("Delete this mission?").getByRole("button", { name: "Delete" }).click();
  await page.waitForURL((url) => url.pathname.startsWith("/projects/"));
  await page.getByRole("row").filter({ hasText: "north ridge" }).waitFor({ state: "detached" });
}
await removeRidge();
await toast("north ridge moved to the trash.").getByRole("button", { name: "Undo" }).click();
await page.waitForURL((url) => url.pathname === `/missions/${ridge}`);
await page.getByRole("heading", { level: 1, name: "north ridge" }).waitFor();
await removeRidge();
await page.getByRole("navigation", { name: "Main" }).getByRole("link", { name: "Trash" }).click();
await page.getByRole("row").filter({ hasText: "north ridge" }).getByRole("button", { name: /^Restore/ }).click();
await toast("north ridge restored.").getByRole("button", { name: "Open" }).click();
await page.getByRole("heading", { level: 1, name: "north ridge" }).waitFor();
results.restoredNotes = await notes.innerText();

// A project: cancels deleting it, deletes it and undoes that, deletes it again and restores it with its missions from the
// trash.
await page.getByRole("navigation", { name: "Breadcrumbs" }).getByRole("link", { name: "Alps" }).click();
const project = new URL(page.url()).pathname;
const removal = dialog("Delete this project?");
async function removeAlps() {
  await page.goto(`${address}${project}?tab=settings`);
  await page.getByRole("button", { name: "Delete project" }).click();
  results.deletionWarning = await removal.innerText();
  await removal.getByLabel("Type Alps to confirm").fill("Alps");
  await removal.getByRole("button", { name: "Delete" }).click();
  await page.waitForURL((url) => url.pathname === "/projects");
  await page.getByText("No projects yet").waitFor();
}
await page.goto(`${address}${project}?tab=settings`);
await page.getByRole("button", { name: "Delete project" }).click();
await removal.waitFor();
await checkPage(page, "project-delete");
await removal.getByRole("button", { name: "Cancel" }).click();
await removal.waitFor({ state: "detached" });
await removeAlps();
await toast("Alps moved to the trash.").getByRole("button", { name: "Undo" }).click();
await page.waitForURL((url) => url.pathname === project);
await page.getByRole("row").filter({ hasText: "north ridge" }).waitFor();
await removeAlps();
await page.getByRole("navigation", { name: "Main" }).getByRole("link", { name: "Trash" }).click();
await page.getByRole("row").filter({ hasText: "Alps" }).getByRole("button", { name: /^Restore/ }).click();
await toast("Alps restored.").getByRole("button", { name: "Open" }).click();
await page.waitForURL((url) => url.pathname === project);
await page.getByRole("row").filter({ hasText: "north ridge" }).waitFor();
await page.getByRole("row").filter({ hasText: "night" }).waitFor();

// A new user without rights: the home page says so, and whom to ask.
const { page: guest } = await openPage(() => expectsErrors);
await guest.goto(invitation);
await guest.getByLabel(/password/i).fill("a long enough password");
await guest.getByRole("button", { name: "Create my account" }).click();
await guest.waitForURL((url) => url.pathname === "/");
await guest.locator("[data-no-access]").waitFor();
results.homeWithoutAccess = await guest.locator("main").innerText();
await checkPage(guest, "home-empty");
await printResults();
