// Time axes: positions, ticks and density; the current time; expiry dates. All in milliseconds since 1970.
import { onScopeDispose, readonly, ref, type Ref } from "vue";

export interface Tick {
  readonly at: number;
  /** Where it is, as a share of the span from 0 to 1. */
  readonly share: number;
  readonly label: string;
}

const S = 1000;
const MIN = 60 * S;
const H = 60 * MIN;
const DAY = 24 * H;
const STEPS = [
  1, 2, 5, 10, 20, 50, 100, 200, 500, S, 2 * S, 5 * S, 10 * S, 15 * S, 30 * S, MIN, 2 * MIN, 5 * MIN, 10 * MIN,
  15 * MIN, 30 * MIN, H, 2 * H, 3 * H, 6 * H, 12 * H, DAY, 2 * DAY, 7 * DAY, 14 * DAY, 30 * DAY, 91 * DAY, 365 * DAY,
] as const;

const withDay = new Intl.DateTimeFormat("en-GB", { day: "numeric", month: "short" });
const withYear = new Intl.DateTimeFormat("en-GB", { month: "short", year: "numeric" });
const withMinute = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit" });
const withSecond = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit" });

const asDate = new Intl.DateTimeFormat("en-GB", { day: "numeric", month: "short", year: "numeric" });
const asZone = new Intl.DateTimeFormat("en-GB", { timeZoneName: "shortOffset" });

function zoneOf(at: number): string {
  const zone = asZone.formatToParts(at).find((part) => part.type === "timeZoneName")?.value ?? "";
  return zone.replace("GMT", "UTC");
}

/** Returns the dates that an axis covers, once, and the zone of its times: `12 May 2026, UTC+2`. */
export function datesOf(start: number, end: number): string {
  const [first, last] = [asDate.format(start), asDate.format(end)];
  return `${first === last ? first : `${first} – ${last}`}, ${zoneOf(start)}`;
}

/** Returns where a time is on a span, as a share from 0 to 1, clamped to it. */
export function shareOf(at: number, start: number, end: number): number {
  if (end <= start) return 0;
  return Math.max(0, Math.min(1, (at - start) / (end - start)));
}

function isMidnight(at: number): boolean {
  const time = new Date(at);
  return time.getHours() === 0 && time.getMinutes() === 0;
}

function labelOf(at: number, step: number): string {
  if (step >= 30 * DAY) return withYear.format(at);
  if (step >= MIN && step < DAY && isMidnight(at)) return withDay.format(at);
  if (step >= DAY) return withDay.format(at);
  if (step >= MIN) return withMinute.format(at);
  if (step >= S) return withSecond.format(at);
  return `${withSecond.format(at)}.${String(((at % S) + S) % S).padStart(3, "0")}`;
}

/** Returns round times of the viewer's zone within a span, at most `most` of them. */
export function ticks(start: number, end: number, most: number): Tick[] {
  const span = end - start;
  if (!(span > 0) || most < 1) return [];
  const step = STEPS.find((item) => span / item <= most) ?? span;
  const zone = new Date(start).getTimezoneOffset() * MIN; // so that days begin at the viewer's midnight
  const first = Math.ceil((start - zone) / step) * step + zone;
  const marks: Tick[] = [];
  for (let at = first; at <= end; at += step) marks.push({ at, share: (at - start) / span, label: labelOf(at, step) });
  return marks;
}

const TICK_MS = 20_000;
const now = ref(new Date());
let watchers = 0;
let timer: ReturnType<typeof setInterval> | undefined;

/** Returns the time, renewed every 20 s for as long as the component lives. */
export function useNow(): Readonly<Ref<Date>> {
  watchers += 1;
  if (timer === undefined) {
    now.value = new Date();
    timer = setInterval(() => (now.value = new Date()), TICK_MS);
  }
  onScopeDispose(() => {
    watchers -= 1;
    if (watchers > 0) return;
    clearInterval(timer);
    timer = undefined;
  });
  return readonly(now);
}

export const SPANS = ["1", "30", "90", "365"] as const;
export type Span = (typeof SPANS)[number];

const two = (value: number) => String(value).padStart(2, "0");

/** Returns the viewer's day of a time: `2026-11-21`. */
export function dayOf(at: Date): string {
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())}`;
}

/** Returns the end of a day of the viewer's, as the API writes times. */
export function endOfDay(day: string): string {
  return new Date(`${day}T23:59:59`).toISOString();
}

/** Returns the beginning of a day of the viewer's, or of the day after it. */
export function startOfDay(day: string, daysLater = 0): string {
  const at = new Date(`${day}T00:00:00`);
  at.setDate(at.getDate() + daysLater);
  return at.toISOString();
}

/** Returns the end of the day in `days` days. */
export function spanEnd(span: Span, now: Date): string {
  const at = new Date(now);
  at.setDate(at.getDate() + Number(span));
  return endOfDay(dayOf(at));
}

/** Returns the drawn columns of a row of counts, in a box of `counts.length` by 1; an empty part leaves a gap. */
export function densityPath(counts: readonly number[]): string {
  const most = counts.reduce((high, count) => Math.max(high, count), 0);
  if (most === 0) return "";
  let path = "";
  let at = 0;
  while (at < counts.length) {
    const count = counts[at] ?? 0;
    let end = at + 1;
    while (end < counts.length && counts[end] === count) end += 1;
    // The root makes a lone message beside thousands still be seen.
    const height = count === 0 ? 0 : Math.max(0.2, Math.sqrt(count / most));
    if (height > 0) path += `M${at} 1V${(1 - height).toFixed(3)}H${end}V1Z`;
    at = end;
  }
  return path;
}

/** Returns the longest stretch of empty parts between two full ones, as a share of the whole. */
export function longestGap(counts: readonly number[]): number {
  const first = counts.findIndex((count) => count > 0);
  let longest = 0;
  let run = 0;
  for (const count of first < 0 ? [] : counts.slice(first)) {
    if (count > 0) {
      longest = Math.max(longest, run);
      run = 0;
    } else run += 1;
  }
  return counts.length === 0 ? 0 : longest / counts.length;
}
