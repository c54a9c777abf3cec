// What is selected of a recording: its times, its estimated size, the name of the file, and the equivalent command.
import type { File, Recording, Topic } from "@/api/types";
import { missionArguments, quoted } from "@/components/commands";
import type { Span } from "@/recordings/formats/recording";

const MS_NS = 1_000_000n;

/** Log times of a selection: from (inclusive), to before (exclusive); null at the ends of the recording. */
export interface Times {
  readonly startNs: bigint | null;
  readonly endNs: bigint | null;
}

/** Returns the length of a recording in milliseconds, rounded up. */
export function lengthMs({ fromNs, toNs }: Span): number {
  return Number((toNs - fromNs + MS_NS - 1n) / MS_NS);
}

/** Returns the times of a range in milliseconds after the start of a recording. */
export function timesOf(span: Span, fromMs: number, toMs: number): Times {
  const at = (ms: number): bigint => span.fromNs + BigInt(Math.round(ms)) * MS_NS;
  return { startNs: fromMs <= 0 ? null : at(fromMs), endNs: toMs >= lengthMs(span) ? null : at(toMs) };
}

/** Returns the range of a text such as `1747035000000000000-1747035010000000000`, in milliseconds after the start of a recording; null for other texts. */
export function rangeIn(text: string, span: Span): { readonly fromMs: number; readonly toMs: number } | null {
  const [, from, to] = /^(\d{1,19})-(\d{1,19})$/.exec(text) ?? [];
  if (from === undefined || to === undefined) return null;
  const ms = (ns: bigint): number => Math.min(lengthMs(span), Math.max(0, Number(ns - span.fromNs) / 1e6));
  const [fromMs, toMs] = [Math.floor(ms(BigInt(from))), Math.ceil(ms(BigInt(to)))];
  return fromMs < toMs ? { fromMs, toMs } : null;
}

/** Returns about how many bytes of messages are selected: the share of each topic that the range covers of it. */
export function estimate(topics: readonly Topic[], span: Span, { startNs, endNs }: Times): number {
  const [from, to] = [Number(startNs ?? span.fromNs), Number(endNs ?? span.toNs)];
  return topics.reduce((sum, { stored_bytes: bytes, first_ns: first, last_ns: last }) => {
    if (bytes === null || first === null || last === null) return sum;
    const covered = Math.max(0, Math.min(to, last) - Math.max(from, first));
    const isInside = first >= from && last <= to;
    return sum + (isInside ? bytes : (bytes * covered) / Math.max(1, last - first));
  }, 0);
}

/** Returns the name under which a selection of a file is saved. */
export function sliceName(path: string): string {
  const name = path.slice(path.lastIndexOf("/") + 1);
  const dot = name.lastIndexOf(".");
  return `${dot > 0 ? name.slice(0, dot) : name}.slice.mcap`;
}

interface Removable {
  remove?: () => Promise<void>;
}

/** Removes the empty file that a browser makes when its place is chosen, after a slice failed or was stopped. */
export async function removeEmpty(handle: FileSystemFileHandle & Removable): Promise<void> {
  try {
    if ((await handle.getFile()).size === 0) await handle.remove?.();
  } catch {
    // It may be gone, or the browser may not allow it: nothing is in it.
  }
}

/** The recording that a file is a part of, and how many files hold its messages. */
export interface SplitRecording {
  readonly name: string;
  readonly files: number;
}

/** Returns the recording of several files that a file is a part of; null for a file that has the whole recording. */
export function splitRecording(file: File, recordings: readonly Recording[]): SplitRecording | null {
  const own = recordings.find(({ file_ids: ids }) => ids.includes(file.id));
  const files = own?.paths.filter((path) => !/(^|\/)metadata\.yaml$/.test(path)).length ?? 0;
  return own === undefined || files < 2 ? null : { name: own.name, files };
}

/** A recording as `klein cut` takes it: a glob that matches its name or path alone, and is no option. */
const recordingArgument = (name: string): string => quoted(name.replace(/[*?[]/g, "[$&]").replace(/^-/, "[-]"));

/** Returns the command that makes a slice of recordings of a mission, to be completed with topics and times. */
export function commandOfSeveral(names: readonly string[], mission: Parameters<typeof missionArguments>[0]): string {
  return ["klein cut", ...names.map(recordingArgument), missionArguments(mission), "--topics /TOPIC --start +10s --end +20s -o selection.mcap"].join(" ");
}

/** Topics as `--topics` takes them: it separates names by commas and spaces, which a glob can stand for. */
const topicArgument = (topic: string): string => quoted(topic.replace(/[\s,]/g, "?"));

/** What `klein cut` takes: topics (null: all) and times. */
export interface CutSelection extends Times {
  readonly topics: readonly string[] | null;
}

/** Returns the command that makes the same file, or that of the whole recording; `topics`: null for all. */
export function commandOf(file: File, split: SplitRecording | null, topics: readonly string[] | null, times: Times): string {
  return cutSelectionCommand([split?.name ?? file.path], file.mission, { topics, ...times }, sliceName(file.path));
}

/** Returns the command that makes one MCAP of a selection of recordings of a mission, which it merges. */
export function cutSelectionCommand(names: readonly string[], mission: Parameters<typeof missionArguments>[0], { topics, startNs, endNs }: CutSelection, target: string): string {
  const options = [
    ...(topics ?? []).flatMap((topic) => ["--topics", topicArgument(topic)]),
    ...(startNs === null ? [] : ["--start", String(startNs)]),
    ...(endNs === null ? [] : ["--end", String(endNs)]),
  ];
  return ["klein cut", ...names.map(recordingArgument), missionArguments(mission), ...options, "-o", quoted(target)].join(" ");
}
