// The values of a plot as rows, for reading and for keeping.

export interface Row {
  readonly seconds: number;
  readonly values: readonly (number | null | undefined)[];
}

/** Returns the points of a plot as rows; what only breaks a curve is none. */
export function rowsOf(seconds: readonly number[], values: readonly (readonly (number | null | undefined)[])[]): Row[] {
  const rows = seconds.map((each, row) => ({ seconds: each, values: values.map((curve) => curve[row]) }));
  return rows.filter((row) => row.values.some((value) => value !== null && value !== undefined));
}

/** Returns a number as a person reads it: enough digits to tell values apart. */
export function shortNumber(value: number | null | undefined): string {
  if (value === null || value === undefined) return "–";
  if (value === 0 || Number.isInteger(value) || (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e7)) return String(Number(value.toPrecision(7)));
  return value.toExponential(5);
}

/** Returns the rows as CSV, every digit kept; `start` is the log time that seconds count from. */
export function csvOf(names: readonly string[], rows: readonly Row[], startNs: bigint): string {
  const quote = (text: string): string => (/[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const head = [`seconds since ${startNs} ns`, ...names].map(quote).join(",");
  const lines = rows.map(({ seconds, values }) => [seconds, ...values.map((value) => value ?? "")].join(","));
  return [head, ...lines, ""].join("\n");
}

/** Returns a curve's least and greatest value; null where it has none. */
export function rangeOf(curve: readonly (number | null | undefined)[]): [number, number] | null {
  let least = Infinity;
  let greatest = -Infinity;
  for (const value of curve) {
    if (value === null || value === undefined) continue;
    if (value < least) least = value;
    if (value > greatest) greatest = value;
  }
  return greatest >= least ? [least, greatest] : null;
}
