// Days at whose end a right ends, in the viewer's zone.

/** Returns the end of a day `2026-11-21`, as the server wants it. */
export function endOfDay(day: string): string {
  const end = new Date(`${day}T00:00:00`);
  end.setDate(end.getDate() + 1);
  return end.toISOString();
}

/** Returns the day whose end a time is, or in which it lies; empty for none. */
export function dayOf(at: string | null): string {
  if (at === null) return "";
  const time = new Date(new Date(at).getTime() - 1);
  const two = (value: number) => String(value).padStart(2, "0");
  return `${time.getFullYear()}-${two(time.getMonth() + 1)}-${two(time.getDate())}`;
}
