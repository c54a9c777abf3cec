// What lasts while a session ends and the server is away: what was typed stays, the page says what to do, and goes on.
// Prints as JSON what was seen. Arguments: the folder with playwright-core, the browser, a link that signs the owner in,
// the server's address, an invitation, the ids of project and mission, the process of the API, a file to upload, where
// pictures go.
import { createRequire } from "node:module";

const [web, executablePath, , address, invitation, mission, api, file, pictures] = process.argv.slice(2);
const { chromium } = createRequire(`${web}/package.json`)("playwright-core");
const PATIENCE_MS = 60_000;
const PASSWORD = "a long enough password";
const EMAIL = "ada@lab.example";

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, reducedMotion: "reduce" });
const page = await context.newPage();
page.setDefaultTimeout(PATIENCE_MS);
const results = { errors: [], loads: 0 };
page.on("pageerror", (error) => results.errors.push(error.message));
page.on("load", () => (results.loads += 1));
const headers = { Origin: address };
await context.request.post(`${address}/api/v1/auth/invitation`, {
  data: { code: new URL(invitation).hash.slice(1), name: "Ada", password: PASSWORD }, headers,
});

/** The same person somewhere else. */
async function elsewhere(act) {
  const other = await browser.newContext();
  await other.request.post(`${address}/api/v1/auth/password`, { data: { email: EMAIL, password: PASSWORD }, headers });
  const status = (await act(other.request)).status();
  await other.close();
  return status;
}
const endSessions = () => elsewhere((request) => request.delete(`${address}/api/v1/me/sessions`, { headers }));

const dialog = page.getByRole("dialog", { name: "Your session has ended" });

/** Signs in anew in the window that opens, after what the page says was noted. */
async function signInAgain(name) {
  await dialog.waitFor();
  results[`${name}Told`] = await dialog.innerText();
  await page.screenshot({ path: `${pictures}/lasting-${name}.png` });
  const [popup] = await Promise.all([page.waitForEvent("popup"), dialog.getByRole("button", { name: "Sign in" }).click()]);
  await popup.getByLabel("E-mail address").fill(EMAIL);
  await popup.getByLabel("Password").fill(PASSWORD);
  await popup.getByRole("button", { name: "Sign in" }).click();
  await dialog.waitFor({ state: "hidden" });
}

// A form of metadata and notes, half filled when the session ends.
await page.goto(`${address}/missions/${mission}`);
const metadata = page.locator("[data-metadata]");
await metadata.getByRole("button", { name: "ada" }).click();
await metadata.getByLabel("operator").fill("grace");
const notes = page.locator("[data-notes]");
await notes.getByRole("button").click();
await notes.getByRole("textbox").fill("Snow on the ridge.");
results.ended = await endSessions();
await metadata.getByRole("button", { name: "Save" }).click();
await dialog.waitFor();
results.kept = [await metadata.getByLabel("operator").inputValue(), await notes.getByRole("textbox").inputValue()];
await signInAgain("metadata");
await metadata.getByRole("button", { name: "grace" }).waitFor();
const save = notes.getByRole("button", { name: "Save" });
await endSessions();
await save.evaluate((button) => button.click()); // whether or not the page knows by now, and asks in front of it
const eventsResponse = page.waitForResponse((answer) => answer.url().includes("/api/v1/events") && answer.ok());
await signInAgain("notes");
await eventsResponse;
await notes.locator("p", { hasText: "Snow on the ridge." }).waitFor();

// The API dies while a form is half filled, and comes back by its supervisor.
await metadata.getByRole("button", { name: "grace" }).click();
await metadata.getByLabel("operator").fill("edith");
process.kill(Number(api), "SIGKILL");
const away = page.getByText("The server does not respond.");
await away.waitFor();
results.away = await away.innerText();
results.alerts = await page.getByRole("alert").count();
await page.screenshot({ path: `${pictures}/lasting-away.png` });
await away.waitFor({ state: "detached" });
results.keptWhileAway = await metadata.getByLabel("operator").inputValue();
await metadata.getByRole("button", { name: "Save" }).click();
await metadata.getByRole("button", { name: "edith" }).waitFor();

// What changes elsewhere shows by itself again.
const changed = { data: { notes: "Changed elsewhere." }, headers };
results.changed = await elsewhere((request) => request.patch(`${address}/api/v1/missions/${mission}`, changed));
await notes.locator("p", { hasText: "Changed elsewhere." }).waitFor();
results.loadsOfMission = results.loads;

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
results.keptOfUpload = [await page.getByLabel("Mission name").inputValue(), await page.getByLabel("operator").inputValue()];
await signInAgain("upload");
await page.locator("[data-phase=over]").waitFor();
results.over = await page.locator("[data-phase]").first().innerText();
await browser.close();
process.stdout.write(JSON.stringify(results));
