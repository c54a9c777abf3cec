// Numbers, sizes and durations for people, by the same rules as the CLI.
const NS_PER_S = 1_000_000_000;
const NS_PER_MS = 1_000_000;
const DAY_S = 86_400;
const YEAR_S = 365.25 * DAY_S;
/** From here on hours and minutes are hard to read. */
const LONG_S = 100 * 3600;
const SIZES = ["B", "kB", "MB", "GB", "TB"] as const;
const grouped = new Intl.NumberFormat("en-GB");

/** Bytes, in decimal units: `12.3 MB`. */
export function formatSize(bytes: number): string {
  let value = bytes;
  let unit = 0;
  while (value >= 1000 && unit < SIZES.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return unit === 0 ? `${Math.round(value)} B` : `${value.toFixed(1)} ${SIZES[unit] ?? ""}`;
}

/** Bytes a second: `12.3 MB/s`. */
export function formatSpeed(bytesPerSecond: number): string {
  return `${formatSize(bytesPerSecond)}/s`;
}

/** A span of nanoseconds: `6 s`, `1.250 s`, `3 min 05 s`, `2 h 14 min`, `12.5 days`, `11.7 years`. */
export function formatDuration(nanoseconds: number): string {
  const seconds = nanoseconds / NS_PER_S;
  if (Math.abs(seconds) < 60) return `${Number.isInteger(seconds) ? seconds : seconds.toFixed(Math.abs(seconds) < 10 ? 3 : 1)} s`;
  if (Math.abs(seconds) >= YEAR_S) return `${(seconds / YEAR_S).toFixed(1)} years`;
  if (Math.abs(seconds) >= LONG_S) return `${(seconds / DAY_S).toFixed(1)} days`;
  const whole = Math.round(seconds);
  const hours = Math.floor(whole / 3600);
  const minutes = Math.floor(whole / 60) % 60;
  const two = (value: number) => String(value).padStart(2, "0");
  return hours > 0 ? `${hours} h ${two(minutes)} min` : `${minutes} min ${two(whole % 60)} s`;
}

/** A sum of recorded time; a long one in hours: `1,204 h`. */
export function formatHours(nanoseconds: number): string {
  const seconds = nanoseconds / NS_PER_S;
  return seconds < LONG_S ? formatDuration(nanoseconds) : `${grouped.format(Math.round(seconds / 3600))} h`;
}

/** A rate: `12.50 Hz`. */
export function formatRate(hertz: number): string {
  return `${hertz.toFixed(2)} Hz`;
}

/** A count with its thousands apart: `12,345`. */
export function formatCount(count: number): string {
  return grouped.format(count);
}

/** A count and its noun: `1 file`, `12 files`. */
export function counted(count: number, one: string, many = `${one}s`): string {
  return `${formatCount(count)} ${count === 1 ? one : many}`;
}

/** A share of a whole, in percent: `42 %`; never 100 while something is missing. */
export function formatShare(part: number, whole: number): string {
  if (whole <= 0) return "0 %";
  const percent = (100 * part) / whole;
  return `${part < whole ? Math.min(99, Math.floor(percent)) : 100} %`;
}

/** The date of a log time in nanoseconds since 1970. */
export function dateOfNs(nanoseconds: number): Date {
  return new Date(nanoseconds / NS_PER_MS);
}

const day = new Intl.DateTimeFormat("en-GB", { year: "numeric", month: "short", day: "numeric" });
const minute = new Intl.DateTimeFormat("en-GB", {
  year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit",
});
const second = new Intl.DateTimeFormat("en-GB", {
  year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", second: "2-digit",
});
const FORMATS = { day, minute, second } as const;
export type Precision = keyof typeof FORMATS;

/** A time in the viewer's zone: `21 Nov 2026, 20:37`. */
export function formatTime(at: Date, precision: Precision = "minute"): string {
  return Number.isNaN(at.getTime()) ? "–" : FORMATS[precision].format(at);
}

/** The same time in UTC, to the millisecond, as the command line writes it. */
export function formatUtc(at: Date): string {
  return Number.isNaN(at.getTime()) ? "–" : at.toISOString();
}

const AGO: readonly (readonly [Intl.RelativeTimeFormatUnit, number])[] = [
  ["day", 86_400], ["hour", 3600], ["minute", 60], ["second", 1],
];
const relative = new Intl.RelativeTimeFormat("en", { numeric: "auto" });

/** How long ago, or in how long: `3 hours ago`; beyond 30 days the date. */
export function formatAgo(at: Date, now: Date): string {
  const seconds = (at.getTime() - now.getTime()) / 1000;
  if (Number.isNaN(seconds) || Math.abs(seconds) > 30 * 86_400) return formatTime(at, "day");
  const [unit, length] = AGO.find(([, size]) => Math.abs(seconds) >= size) ?? (["second", 1] as const);
  return relative.format(Math.trunc(seconds / length), unit);
}

/** Returns a pattern for a typed text: it matches parts of names, unless the text is a pattern itself. */
export function globOf(typed: string): string {
  const text = typed.trim();
  return text === "" || /[*?[]/.test(text) ? text : `*${text}*`;
}
