// Unsaved input survives the end of a session and an unreachable server: the page keeps it, says what to do, and
// continues. Prints the results as JSON. Arguments: the folder with playwright-core, the browser, a sign-in link of the
// owner (unused), the server's address, an invitation, the id of a mission, the process id of the API, a file to upload,
// the folder for screenshots.
import { launchBrowser } from "./chromium.mjs";

const [web, executablePath, , address, invitation, mission, api, file, pictures] = process.argv.slice(2);
const TIMEOUT_MS = 60_000;
const PASSWORD = "a long enough password";
const EMAIL = "ada@lab.example";

const browser = await launchBrowser(web, executablePath);
const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, reducedMotion: "reduce" });
const page = await context.newPage();
page.setDefaultTimeout(TIMEOUT_MS);
const results = { errors: [], loads: 0 };
page.on("pageerror", (error) => results.errors.push(error.message));
page.on("load", () => (results.loads += 1));
const headers = { Origin: address };
await context.request.post(`${address}/api/v1/auth/invitation`, {
  data: { code: new URL(invitation).hash.slice(1), name: "Ada", password: PASSWORD }, headers,
});

/** Sends a request from another session of the same person, and returns its status. */
async function fromOtherSession(send) {
  const other = await browser.newContext();
  await other.request.post(`${address}/api/v1/auth/password`, { data: { email: EMAIL, password: PASSWORD }, headers });
  const status = (await send(other.request)).status();
  await other.close();
  return status;
}
const endSessions = () => fromOtherSession((request) => request.delete(`${address}/api/v1/me/sessions`, { headers }));

const dialog = page.getByRole("dialog", { name: "Your session has ended" });

/** Records what the page says, and signs in again in the window that it opens. */
async function signInAgain(name) {
  await dialog.waitFor();
  results[`${name}Message`] = await dialog.innerText();
  await page.screenshot({ path: `${pictures}/lasting-${name}.png` });
  const [popup] = await Promise.all([page.waitForEvent("popup"), dialog.getByRole("button", { name: "Sign in" }).click()]);
  await popup.getByLabel("E-mail address").fill(EMAIL);
  await popup.getByLabel("Password").fill(PASSWORD);
  await popup.getByRole("button", { name: "Sign in" }).click();
  await dialog.waitFor({ state: "hidden" });
}

// The session ends while forms of metadata and notes have unsaved input.
await page.goto(`${address}/missions/${mission}`);
const metadata = page.locator("[data-metadata]");
await metadata.getByRole("button", { name: "ada" }).click();
await metadata.getByLabel("operator").fill("grace");
const notes = page.locator("[data-notes]");
await notes.getByRole("button").click();
await notes.getByRole("textbox").fill("Snow on the ridge.");
results.endStatus = await endSessions();
await metadata.getByRole("button", { name: "Save" }).click();
await dialog.waitFor();
results.keptInputs = [await metadata.getByLabel("operator").inputValue(), await notes.getByRole("textbox").inputValue()];
await signInAgain("metadata");
await metadata.getByRole("button", { name: "grace" }).waitFor();
const save = notes.getByRole("button", { name: "Save" });
await endSessions();
await save.evaluate((button) => button.click()); // by script: a dialog may already cover the button
const eventsResponse = page.waitForResponse((response) => response.url().includes("/api/v1/events") && response.ok());
await signInAgain("notes");
await eventsResponse;
await notes.locator("p", { hasText: "Snow on the ridge." }).waitFor();

// The API is killed while a form has unsaved input, and its supervisor restarts it.
await metadata.getByRole("button", { name: "grace" }).click();
await metadata.getByLabel("operator").fill("edith");
process.kill(Number(api), "SIGKILL");
const notice = page.getByText("The server does not respond.");
await notice.waitFor();
results.unreachable = await notice.innerText();
results.alerts = await page.getByRole("alert").count();
await page.screenshot({ path: `${pictures}/lasting-away.png` });
await notice.waitFor({ state: "detached" });
results.keptWhileUnreachable = await metadata.getByLabel("operator").inputValue();
await metadata.getByRole("button", { name: "Save" }).click();
await metadata.getByRole("button", { name: "edith" }).waitFor();

// Changes of other sessions appear without a reload again.
const changed = { data: { notes: "Changed elsewhere." }, headers };
results.changeStatus = await fromOtherSession((request) => request.patch(`${address}/api/v1/missions/${mission}`, changed));
await notes.locator("p", { hasText: "Changed elsewhere." }).waitFor();
results.missionPageLoads = results.loads;

// The form of an upload.
await page.goto(`${address}/upload`);
const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Choose files" }).click()]);
await chooser.setFiles(file);
await page.getByLabel("Project").selectOption({ label: "Alps" });
await page.getByLabel("Mission").selectOption({ label: "New mission" });
await page.getByLabel("Mission name").fill("second");
await page.getByLabel("operator").fill("beatrice");
await endSessions();
await page.getByRole("button", { name: /^Upload 1 file/ }).click();
await dialog.waitFor();
results.keptUploadInputs = [await page.getByLabel("Mission name").inputValue(), await page.getByLabel("operator").inputValue()];
await signInAgain("upload");
await page.locator("[data-phase=over]").waitFor();
results.finished = await page.locator("[data-phase]").first().innerText();
await browser.close();
process.stdout.write(JSON.stringify(results));
