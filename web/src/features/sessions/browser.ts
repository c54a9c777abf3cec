// What a browser says of itself, in two words. It can say anything: this names, and decides nothing.
import { texts } from "@/texts/sessions";

// In this order: most browsers say that they are also another one.
const BROWSERS: readonly (readonly [string, RegExp])[] = [
  ["Edge", /\bEdg(?:e|A|iOS)?\//],
  ["Opera", /\bOPR\//],
  ["Samsung Internet", /\bSamsungBrowser\//],
  ["Firefox", /\b(?:Firefox|FxiOS)\//],
  ["Chrome", /\b(?:Chrome|CriOS|HeadlessChrome|Chromium)\//],
  ["Safari", /\bSafari\//],
];
const SYSTEMS: readonly (readonly [string, RegExp])[] = [
  ["Android", /\bAndroid\b/],
  ["iPhone", /\biPhone\b/],
  ["iPad", /\biPad\b/],
  ["Windows", /\bWindows\b/],
  ["macOS", /\bMac OS X\b|\bMacintosh\b/],
  ["ChromeOS", /\bCrOS\b/],
  ["Linux", /\bLinux\b|\bX11\b/],
];

function named(text: string, among: readonly (readonly [string, RegExp])[]): string | undefined {
  return among.find(([, sign]) => sign.test(text))?.[0];
}

/** Returns a browser's name and system: `Firefox on Linux`. */
export function browserName(userAgent: string | null): string {
  const browser = named(userAgent ?? "", BROWSERS);
  const system = named(userAgent ?? "", SYSTEMS);
  if (browser === undefined) return system ?? texts.unknownBrowser;
  return system === undefined ? browser : texts.on(browser, system);
}
