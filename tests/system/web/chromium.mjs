// Starts Chromium for the browser programs.
import { createRequire } from "node:module";
import { setTimeout as pause } from "node:timers/promises";

const MAX_REPEATS = 5;
const PAUSE_MS = 200;
const SHOWN_CHARACTERS = 3000;

/**
 * Starts the browser. `web` is the folder with playwright-core. Its pages repeat a navigation that the browser aborts
 * because a network interface of this machine has changed: other tests create network namespaces at the same time.
 */
export async function launchBrowser(web, executablePath) {
  const { chromium } = createRequire(`${web}/package.json`)("playwright-core");
  const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
  process.on("uncaughtException", (error) => void describeFailure(browser, error));
  const newContext = browser.newContext.bind(browser);
  browser.newContext = async (options) => {
    const context = await newContext(options);
    const newPage = context.newPage.bind(context);
    context.newPage = async () => withRepeatedNavigation(withRecordedErrors(await newPage()));
    return context;
  };
  return browser;
}

const errorsOf = new WeakMap();

function withRecordedErrors(page) {
  const errors = [];
  errorsOf.set(page, errors);
  page.on("requestfailed", (request) => errors.push(`${request.method()} ${request.url().split("?")[0]}: ${request.failure()?.errorText}`));
  page.on("pageerror", (error) => errors.push(String(error)));
  return page;
}

/** Prints the error, with what each page shows and what failed in it, and ends the program. */
async function describeFailure(browser, error) {
  console.error(error);
  for (const page of browser.contexts().flatMap((context) => context.pages())) {
    const text = await page.locator("body").innerText({ timeout: 5000 }).catch(String);
    console.error(`${page.url()}\n${(errorsOf.get(page) ?? []).slice(-10).join("\n")}\n${text.slice(0, SHOWN_CHARACTERS)}\n`);
  }
  process.exit(1);
}

function withRepeatedNavigation(page) {
  const goto = page.goto.bind(page);
  const reload = page.reload.bind(page);
  page.goto = (url, options) => repeatAborted(() => goto(url, options));
  page.reload = (options) => repeatAborted(() => reload(options));
  return page;
}

async function repeatAborted(navigate) {
  for (let repeats = 0; ; repeats += 1) {
    try {
      return await navigate();
    } catch (error) {
      // The error has no code, only this message.
      if (repeats === MAX_REPEATS || !/net::ERR_NETWORK_CHANGED\b/.test(error.message)) throw error;
      await pause(PAUSE_MS);
    }
  }
}
