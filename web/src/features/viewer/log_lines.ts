// Lines of text from messages: logs of ROS 1, ROS 2 and Foxglove, diagnostics, and plain strings.
import type { Span } from "@/recordings/formats/recording";
import type { PreviewLine } from "@/recordings/preview_file";
import type { PlainValue } from "@/recordings/products/plain_value";

export const LEVELS = ["debug", "info", "warning", "error", "fatal"] as const;
export type Level = (typeof LEVELS)[number];

export interface Line {
  readonly timeNs: bigint;
  readonly level: Level;
  /** Who wrote it: a node, or a component of the diagnostics. */
  readonly source: string;
  readonly text: string;
  /** From the preview, in a part that was not read. */
  readonly isRough?: boolean;
}

interface Fields {
  readonly [name: string]: PlainValue | undefined;
}

type Parse = (fields: Fields) => readonly Omit<Line, "timeNs">[];

/** Sources: rosgraph_msgs/Log, rcl_interfaces/Log, foxglove.Log, diagnostic_msgs/DiagnosticStatus. */
const ROS1_LEVELS: Readonly<Record<number, Level>> = { 1: "debug", 2: "info", 4: "warning", 8: "error", 16: "fatal" };
const ROS2_LEVELS: Readonly<Record<number, Level>> = { 10: "debug", 20: "info", 30: "warning", 40: "error", 50: "fatal" };
const FOXGLOVE_LEVELS: Readonly<Record<number, Level>> = { 1: "debug", 2: "info", 3: "warning", 4: "error", 5: "fatal" };
const DIAGNOSTIC_LEVELS: Readonly<Record<number, Level>> = { 0: "info", 1: "warning", 2: "error", 3: "warning" };

const PARSERS: readonly (readonly [RegExp, Parse])[] = [
  [/^rosgraph_msgs\/(msg\/)?Log$/, (fields) => [{ level: levelOf(fields.level, ROS1_LEVELS), source: textOf(fields.name), text: textOf(fields.msg) }]],
  [/^rcl_interfaces\/msg\/Log$/, (fields) => [{ level: levelOf(fields.level, ROS2_LEVELS), source: textOf(fields.name), text: textOf(fields.msg) }]],
  [/^foxglove(_msgs\/msg\/|\.)Log$/, (fields) => [{ level: levelOf(fields.level, FOXGLOVE_LEVELS), source: textOf(fields.name), text: textOf(fields.message) }]],
  [/^diagnostic_msgs\/(msg\/)?DiagnosticArray$/, (fields) => (Array.isArray(fields.status) ? fields.status.flatMap(ofDiagnostic) : [])],
  [/^std_msgs\/(msg\/)?String$/, (fields) => [{ level: "info", source: "", text: textOf(fields.data) }]],
];

/** Whether messages of a type are lines of text. */
export function isLogType(messageType: string | null): boolean {
  return PARSERS.some(([type]) => type.test(messageType ?? ""));
}

/** Returns the lines of a message; none where it is not of a known type. */
export function linesOf(messageType: string | null, timeNs: bigint, value: PlainValue): Line[] {
  const parse = PARSERS.find(([type]) => type.test(messageType ?? ""))?.[1];
  return isFields(value) && parse !== undefined ? parse(value).map((line) => ({ timeNs, ...line })) : [];
}

/** Returns lines of a preview. What has no level is `info`. */
export function roughLines(lines: readonly PreviewLine[]): Line[] {
  return lines.map(({ severity, ...line }) => ({ ...line, level: levelOf(severity, {}), isRough: true }));
}

/** Returns the lines that were read and, where nothing was read, those of the preview, by time. */
export function withRough(lines: readonly Line[], read: Span | null, rough: readonly Line[]): readonly Line[] {
  const outside = rough.filter(({ timeNs }) => read === null || timeNs < read.fromNs || timeNs > read.toNs);
  return outside.length === 0 ? lines : [...lines, ...outside].toSorted((a, b) => (a.timeNs < b.timeNs ? -1 : a.timeNs > b.timeNs ? 1 : 0));
}

/** Returns the lines at a level or above it that contain a text. */
export function matchingLines(lines: readonly Line[], least: Level, text: string): readonly Line[] {
  const words = text.trim().toLowerCase();
  const from = LEVELS.indexOf(least);
  return lines.filter((line) => LEVELS.indexOf(line.level) >= from && (words === "" || `${line.source} ${line.text}`.toLowerCase().includes(words)));
}

/** Returns the place of the last line at or before a time; -1 where all are later. */
export function placeAt(lines: readonly Line[], timeNs: bigint): number {
  return lines.findLastIndex((line) => line.timeNs <= timeNs);
}

function ofDiagnostic(status: PlainValue): Omit<Line, "timeNs">[] {
  if (!isFields(status)) return [];
  return [{ level: levelOf(status.level, DIAGNOSTIC_LEVELS), source: textOf(status.name), text: textOf(status.message) }];
}

function isFields(value: PlainValue): value is { [name: string]: PlainValue } {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

/** JSON writes the levels of protobuf by their names. */
function levelOf(value: PlainValue | undefined, levels: Readonly<Record<number, Level>>): Level {
  if (typeof value === "string") return LEVELS.find((level) => level === value.toLowerCase()) ?? "info";
  return (typeof value === "number" ? levels[value] : undefined) ?? "info";
}

function textOf(value: PlainValue | undefined): string {
  return typeof value === "string" ? value : "";
}
