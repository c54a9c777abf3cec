// The curves of a plot, as its layout writes them: a field or what is computed from fields, and its axis.
import { chosenFields, leaves, type AxisSide } from "@/features/file/viewer/plot";
import { derivationOf, derivationText } from "@/recordings/curves/derivation_text";
import type { FieldNode } from "@/recordings/decoding/fields";
import { MAX_CURVES } from "@/recordings/limits";

/** A field of another topic. */
export interface OtherField {
  readonly recording: string;
  readonly topic: string;
  readonly field: string;
}

export interface PlotCurve {
  /** What is read of the topic: the path of a field, or what is computed from each message. */
  readonly column: string;
  /** What is subtracted from it, if it is of another topic. */
  readonly minus: OtherField | null;
  readonly side: AxisSide;
}

const RIGHT = "@right";

/** Returns the curve that a text of a layout describes: `linear_acceleration.x`, `norm(angular_velocity)@right`. */
export function curveOf(text: string): PlotCurve {
  const side = text.endsWith(RIGHT) ? "right" : "left";
  const column = side === "right" ? text.slice(0, -RIGHT.length) : text;
  const derivation = derivationOf(column);
  const [field, source, minusField] = derivation?.name === "difference" ? derivation.parts : [];
  if (field === undefined || source === undefined || minusField === undefined) return { column, minus: null, side };
  const at = source.indexOf("@");
  return { column: field, minus: { recording: source.slice(0, at), topic: source.slice(at + 1), field: minusField }, side };
}

/** Returns what a curve is, without its axis. */
export function curveKey({ column, minus }: PlotCurve): string {
  return minus === null ? column : derivationText({ name: "difference", parts: [column, `${minus.recording}@${minus.topic}`, minus.field] });
}

export function curveText(curve: PlotCurve): string {
  return `${curveKey(curve)}${curve.side === "right" ? RIGHT : ""}`;
}

/** Returns a text of a layout with another recording in it; null where the recording has no other. */
export function withRecording(text: string, recordingOf: (field: OtherField) => string | null): string | null {
  const curve = curveOf(text);
  if (curve.minus === null) return text;
  const recording = recordingOf(curve.minus);
  return recording === null ? null : curveText({ ...curve, minus: { ...curve.minus, recording } });
}

/** Returns a curve for people. */
export function curveName({ column, minus }: PlotCurve): string {
  if (minus !== null) return `${column} − ${minus.topic} ${minus.field}`;
  const derivation = derivationOf(column);
  if (derivation === null) return column;
  const [first = "", second = ""] = derivation.parts;
  if (derivation.name === "norm") return `|${first}|`;
  return derivation.name === "derivative" ? `d/dt ${first}` : `${first} − ${second}`;
}

/** Whether a curve is computed: the extremes in a preview do not tell its own. */
export function isDerived({ column, minus }: PlotCurve): boolean {
  return minus !== null || derivationOf(column) !== null;
}

/** Returns the curves that a layout selects, whether or not the topic has them. */
export function layoutCurves(texts: readonly string[]): readonly PlotCurve[] {
  return texts.map(curveOf).slice(0, MAX_CURVES);
}

/** Returns the curves that a layout selects and the topic has, else the defaults of the type. */
export function chosenCurves(nodes: readonly FieldNode[], texts: readonly string[], messageType: string | null): readonly PlotCurve[] {
  const [fields, vectors] = [new Set(leaves(nodes)), new Set(vectorPaths(nodes))];
  const available = texts.map(curveOf).filter(({ column }) => {
    const derivation = derivationOf(column);
    if (derivation === null) return fields.has(column);
    return derivation.parts.every((path) => (derivation.name === "norm" ? vectors : fields).has(path));
  });
  return available.length > 0 ? available.slice(0, MAX_CURVES) : chosenFields(nodes, [], messageType).map(curveOf);
}

const ELEMENT = /^\[[0-3]\]$/;

/** Returns the paths of vectors: groups of x, y, z and w, and arrays of two to four numbers. That of a message is empty. */
export function vectorPaths(nodes: readonly FieldNode[]): string[] {
  return [...vectorOf(nodes), ...nodes.flatMap(({ children, hidden }) => (hidden > 0 ? [] : vectorPaths(children)))];
}

function vectorOf(nodes: readonly FieldNode[]): string[] {
  const paths = nodes.flatMap(({ path }) => path ?? []);
  const isVector = nodes.some(({ label }) => label === "x") && nodes.some(({ label }) => label === "y");
  const isArray = nodes.length >= 2 && nodes.length <= 4 && nodes.every(({ label }) => ELEMENT.test(label));
  const [first] = isVector ? paths.filter((path) => /(^|\.)x$/.test(path)) : isArray ? paths : [];
  if (first === undefined || (isArray && paths.length !== nodes.length)) return [];
  return [first.replace(isArray ? /\[0\]$/ : /\.?x$/, "")];
}
