// Recordings of different clocks: a flight log may count from the start of its computer, and another follow UTC.
import type { ViewerData, ViewerTopic } from "./queries";
import { recordedSpans, type SourceRecording } from "./sources";
import type { Span } from "@/recordings/formats/recording";

/** What was recorded without a long silence. It has a time axis of its own. */
export interface TimeGroup extends ViewerData {
  /** All recordings, with the files of this group only, so that panels of others are without messages. */
  readonly recordings: readonly SourceRecording[];
  /** The topics of the recordings that have files in this group. */
  readonly topics: readonly ViewerTopic[];
  /** When something was recorded, in order. */
  readonly recorded: readonly Span[];
  readonly span: Span;
}

/** Recordings that are further apart have different clocks, or are viewed one after the other. */
const MAX_SILENCE_NS = 86_400_000_000_000n;

/** Returns the groups in order of time. */
export function timeGroups(data: ViewerData): readonly TimeGroup[] {
  const groups: Span[][] = [];
  for (const span of recordedSpans(data.recordings)) {
    const last = groups.at(-1)?.at(-1);
    if (last === undefined || span.fromNs - last.toNs > MAX_SILENCE_NS) groups.push([span]);
    else groups.at(-1)?.push(span);
  }
  return groups.map((recorded) => {
    const span = { fromNs: recorded[0]?.fromNs ?? 0n, toNs: recorded.at(-1)?.toNs ?? 0n };
    return groups.length === 1 ? { ...data, recorded, span } : partOf(data, recorded, span);
  });
}

function partOf({ recordings, topics }: ViewerData, recorded: readonly Span[], span: Span): TimeGroup {
  const own = recordings.map((recording) => ({ ...recording, files: recording.files.filter((file) => isWithin(span, file.span.fromNs)) }));
  const present = new Set(own.filter(({ files }) => files.length > 0).map(({ key }) => key));
  const isFirstHere = (firstNs: number | null) => firstNs !== null && firstNs >= Number(span.fromNs) && firstNs <= Number(span.toNs);
  // The density of a topic is that of the whole time, which this axis does not show.
  const ofGroup = topics.filter(({ recording }) => present.has(recording)).map((topic) => ({ ...topic, firstNs: isFirstHere(topic.firstNs) ? topic.firstNs : null, density: [] }));
  return { recordings: own, topics: ofGroup, recorded, span };
}

/** Returns the group of a time; without one, the current group, or that with the most messages. */
export function groupAt(groups: readonly TimeGroup[], timeNs: bigint | null, current: TimeGroup | null | undefined): TimeGroup | null {
  const ofTime = timeNs === null ? undefined : groups.find(({ span }) => isWithin(span, timeNs));
  if (ofTime !== undefined) return ofTime;
  if (current != null && groups.includes(current)) return current;
  return groups.toSorted((a, b) => messagesOf(b) - messagesOf(a) || b.topics.length - a.topics.length)[0] ?? null;
}

function messagesOf({ topics }: TimeGroup): number {
  return topics.reduce((sum, { count }) => sum + (count ?? 0), 0);
}

function isWithin({ fromNs, toNs }: Span, timeNs: bigint): boolean {
  return timeNs >= fromNs && timeNs <= toNs;
}
