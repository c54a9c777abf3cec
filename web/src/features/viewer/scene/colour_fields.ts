// The fields that points can be coloured by, and their values as shares of their ranges.
import { rangeOf, type PointSet } from "@/recordings/geometry/points";

const AXES = ["x", "y", "z"];
/** The share of a point whose value is no number. */
export const NO_VALUE = -1;

/** Returns the fields that points can be coloured by: channels, packed colours, and axes. */
export function colourFields({ channels, colours }: PointSet): readonly string[] {
  return [...channels.map(({ name }) => name), ...(colours === null ? [] : [colours.name]), ...AXES];
}

/** Returns the field that colours the points: the chosen one if they have it, else the first. Empty: one colour. */
export function colourFieldOf(points: PointSet, chosen: string | null): string {
  if (chosen === "") return "";
  if (chosen !== null && colourFields(points).includes(chosen)) return chosen;
  return points.colours?.name ?? points.channels[0]?.name ?? "z";
}

/** Returns the values of a field from 0 to 1 by their range; null for a field without values. */
export function sharesOf(points: PointSet, field: string): Float32Array<ArrayBuffer> | null {
  const axis = AXES.indexOf(field);
  const channel = points.channels.find(({ name }) => name === field);
  if (channel === undefined && axis < 0) return null;
  const count = points.positions.length / 3;
  const values = channel?.values ?? Float32Array.from({ length: count }, (_, place) => points.positions[3 * place + axis] ?? 0);
  const range = channel === undefined ? rangeOf(values) : channel.range;
  if (range === null) return null;
  const [least, greatest] = range;
  const scale = greatest > least ? 1 / (greatest - least) : 0;
  const shares = new Float32Array(count);
  for (let place = 0; place < count; place += 1) {
    const share = ((values[place] ?? Number.NaN) - least) * scale;
    shares[place] = Number.isFinite(share) ? share : NO_VALUE;
  }
  return shares;
}
