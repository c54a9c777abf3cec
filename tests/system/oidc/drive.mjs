// Drives one Chromium, told how by JSON lines on stdin; answers each with a line: {"told": …} or {"error": …}.
import { createInterface } from "node:readline";
import { chromium } from "playwright-core";

const patience = { timeout: 60_000 };
const browser = await chromium.launch({ executablePath: process.argv[2], args: ["--no-sandbox"] });
let context;
let page;
let kept;
let stopKeeping;
let complaints = [];

async function fresh() {
  if (context) await context.close();
  context = await browser.newContext();
  page = await context.newPage();
  complaints = [];
  page.on("console", (message) => {
    if (message.type() === "error" && /Content Security Policy/.test(message.text())) complaints.push(message.text());
  });
}

function late() {
  const tooLong = () => new Error("the browser did not go there");
  return new Promise((_, reject) => setTimeout(() => reject(tooLong()), patience.timeout).unref());
}

const acts = {
  fresh,
  // A page may go on to another address before it has loaded.
  goto: async ({ url }) => void (await page.goto(url, { ...patience, waitUntil: "commit" })),
  fill: async ({ selector, value }) => void (await page.fill(selector, value, patience)),
  click: async ({ selector }) => void (await page.click(selector, patience)),
  see: async ({ text }) => void (await page.getByText(text).first().waitFor(patience)),
  arrive: async ({ path }) => {
    await page.waitForURL((url) => url.pathname === path, { ...patience, waitUntil: "commit" });
    return page.url();
  },
  text: async () => page.innerText("body", patience),
  url: async () => page.url(),
  cookies: async () => context.cookies(),
  complaints: async () => complaints,
  // From now on the browser does not go to addresses like `pattern` (with * for anything), but keeps the last of them.
  // By Chromium's own protocol: Playwright's routes do not see where a redirect leads.
  keep: async ({ pattern }) => {
    const protocol = await context.newCDPSession(page);
    kept = new Promise((resolve) => {
      protocol.on("Fetch.requestPaused", async ({ requestId, request }) => {
        resolve(request.url);
        await protocol.send("Fetch.failRequest", { requestId, errorReason: "Aborted" });
      });
    });
    await protocol.send("Fetch.enable", { patterns: [{ urlPattern: pattern }] });
    stopKeeping = () => protocol.send("Fetch.disable");
  },
  kept: async () => {
    const url = await Promise.race([kept, late()]);
    await stopKeeping();
    return url;
  },
};

await fresh();
console.log(JSON.stringify({ told: browser.version() }));
for await (const line of createInterface({ input: process.stdin })) {
  const { act, ...how } = JSON.parse(line);
  try {
    console.log(JSON.stringify({ told: (await acts[act](how)) ?? null }));
  } catch (error) {
    console.log(JSON.stringify({ error: `${act} ${JSON.stringify(how)} at ${page.url()}: ${error.message}` }));
  }
}
await browser.close();
