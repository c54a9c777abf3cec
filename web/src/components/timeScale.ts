// Times on an axis: where they are on it, and which of them are written there. All in milliseconds since 1970.
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
  const step = STEPS.find((each) => span / each <= most) ?? span;
  const zone = new Date(start).getTimezoneOffset() * MIN; // so that days begin at the viewer's midnight
  const first = Math.ceil((start - zone) / step) * step + zone;
  const found: Tick[] = [];
  for (let at = first; at <= end; at += step) found.push({ at, share: (at - start) / span, label: labelOf(at, step) });
  return found;
}
