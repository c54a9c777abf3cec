// Rows, CSV and value ranges of a plot, and the fields that it shows by default.
import type { FieldNode } from "@/recordings/decoding/fields";
import { MAX_CURVES } from "@/recordings/limits";

export interface Row {
  readonly seconds: number;
  readonly values: readonly (number | null | undefined)[];
}

/** Returns the points of a plot as rows; what only breaks a curve is none. */
export function rowsOf(seconds: readonly number[], values: readonly (readonly (number | null | undefined)[])[]): Row[] {
  const rows = seconds.map((second, row) => ({ seconds: second, values: values.map((curve) => curve[row]) }));
  return rows.filter((row) => row.values.some((value) => value !== null && value !== undefined));
}

/** Returns a readable number with enough digits to distinguish values. */
export function shortNumber(value: number | null | undefined): string {
  if (value === null || value === undefined) return "–";
  if (value === 0 || Number.isInteger(value) || (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e7)) return String(Number(value.toPrecision(7)));
  return value.toExponential(5);
}

/** Returns a cell of CSV. */
export function quoted(text: string): string {
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** Returns the rows as CSV, every digit kept; `start` is the log time that seconds count from. */
export function csvOf(names: readonly string[], rows: readonly Row[], startNs: bigint): string {
  const head = [`seconds since ${startNs} ns`, ...names].map(quoted).join(",");
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

export type AxisSide = "left" | "right";

/** Returns the label of an axis by the units of its curves, where they are known. */
export function axisLabel(units: readonly (string | null)[]): string {
  return [...new Set(units.filter((unit) => unit !== null))].join(", ");
}

/** Default fields of well-known types. */
const FIRST: readonly (readonly [RegExp, readonly string[]])[] = [
  [/[/.]Imu$/, ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]],
  [/[/.]NavSatFix$/, ["altitude"]],
  [/[/.]Odometry$/, ["pose.pose.position.x", "pose.pose.position.y", "pose.pose.position.z"]],
  [/[/.]JointState$/, ["position[0]", "position[1]", "position[2]"]],
];
const NOT_FIRST = /(^|\.)(header|stamp|timestamp\w*|seq|sec|nanosec|nsec)(\.|$)|covariance/;
const DEFAULT_CURVES = 4;

/** Returns the names of all fields of a tree. */
export function leaves(nodes: readonly FieldNode[]): string[] {
  return nodes.flatMap((node) => (node.path === null ? leaves(node.children) : [node.path]));
}

/** Returns the fields to plot: the selected ones that exist, else the defaults of the type. */
export function chosenFields(nodes: readonly FieldNode[], selected: readonly string[], messageType: string | null): string[] {
  const all = leaves(nodes);
  const available = selected.filter((field) => all.includes(field)).slice(0, MAX_CURVES);
  if (available.length > 0) return available;
  const known = FIRST.find(([type]) => type.test(messageType ?? ""))?.[1].filter((field) => all.includes(field)) ?? [];
  if (known.length > 0) return known;
  return groups(nodes).find((group) => group.every((field) => !NOT_FIRST.test(field)))?.slice(0, DEFAULT_CURVES) ?? all.slice(0, 1);
}

/** The fields by group, outer groups first. */
function groups(nodes: readonly FieldNode[]): string[][] {
  const own = nodes.flatMap(({ path }) => (path === null ? [] : [path]));
  const plain = own.filter((field) => !NOT_FIRST.test(field));
  const inner = nodes.flatMap(({ children }) => groups(children));
  return plain.length > 0 ? [plain, ...inner] : inner;
}
