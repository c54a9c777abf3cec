// What a run used, as small curves: levels where levels were measured, rates where sums were.
import type { Sample } from "./queries";

export interface Curve {
  readonly at: readonly number[];
  readonly values: readonly number[];
}

type Key = "cpu_s" | "memory_bytes" | "read_bytes" | "written_bytes";

/** Returns what was used at each moment. */
export function levels(samples: readonly Sample[], key: Key): Curve {
  return { at: samples.map((each) => each.at_s), values: samples.map((each) => each.usage[key]) };
}

/** Returns how fast a sum grew from moment to moment. */
export function rates(samples: readonly Sample[], key: Key): Curve {
  const at: number[] = [];
  const values: number[] = [];
  for (const [index, sample] of samples.entries()) {
    const before = samples[index - 1];
    if (before === undefined || sample.at_s <= before.at_s) continue;
    at.push(sample.at_s);
    values.push(Math.max(0, sample.usage[key] - before.usage[key]) / (sample.at_s - before.at_s));
  }
  return { at, values };
}

export function most({ values }: Curve): number {
  return values.reduce((high, value) => Math.max(high, value), 0);
}

/** Returns a curve as the outline of a filled area, in a box of 100 by 1. */
export function areaOf(curve: Curve): string {
  const [first, last] = [curve.at[0] ?? 0, curve.at.at(-1) ?? 0];
  const high = most(curve);
  if (curve.at.length === 0 || high === 0) return "";
  const x = (at: number) => (last === first ? 0 : (100 * (at - first)) / (last - first)).toFixed(2);
  const points = curve.at.map((at, index) => `L${x(at)} ${(1 - (curve.values[index] ?? 0) / high).toFixed(4)}`);
  const end = last === first ? `L100 ${(1 - (curve.values.at(-1) ?? 0) / high).toFixed(4)}` : "";
  return `M0 1${points.join("")}${end}L100 1Z`;
}
