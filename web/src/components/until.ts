// Ends of rights, memberships and tokens. A day that is chosen is one of the viewer's, and holds to its end.

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

/** Returns the end of the day that is so many days from now. */
export function spanEnd(span: Span, now: Date): string {
  const at = new Date(now);
  at.setDate(at.getDate() + Number(span));
  return endOfDay(dayOf(at));
}
