// What is said of the topics of a mission beside their densities.
import type { MissionTopic, TimelineFile, Topics } from "./queries";
import type { RouteLocationRaw } from "vue-router";

/** Returns how many stretches without messages lie between a topic's first and last, and their share of all of it. */
export function silences(counts: readonly number[]): { readonly count: number; readonly share: number } {
  const first = counts.findIndex((item) => item > 0);
  const last = counts.findLastIndex((item) => item > 0);
  let [count, empty] = [0, 0];
  for (let at = first; at >= 0 && at <= last; at += 1) {
    if (counts[at] !== 0) continue;
    empty += 1;
    if (counts[at - 1] !== 0) count += 1;
  }
  return { count, share: empty === 0 ? 0 : empty / (last - first + 1) };
}

/** Returns the topics in whose name or type a text occurs. */
export function matching(topics: readonly MissionTopic[], text: string): readonly MissionTopic[] {
  const lowered = text.toLocaleLowerCase();
  if (lowered === "") return topics;
  return topics.filter(({ name, message_type: type }) => name.toLocaleLowerCase().includes(lowered) || type?.toLocaleLowerCase().includes(lowered));
}

/** Returns an order of topics: `name`, `count`, `rate` or `gap`, turned round by a minus before it. */
export function sorted(topics: readonly MissionTopic[], order: string): readonly MissionTopic[] {
  const [key, turn] = order.startsWith("-") ? [order.slice(1), -1] : [order, 1];
  const values: Readonly<Record<string, (topic: MissionTopic) => number | null>> = {
    count: (topic) => topic.count,
    rate: (topic) => topic.rate_hz,
    gap: (topic) => topic.longest_gap_ns,
  };
  const value = values[key];
  if (value === undefined) return turn === 1 ? topics : [...topics].reverse();
  return [...topics].sort((one, other) => turn * ((value(one) ?? -1) - (value(other) ?? -1)));
}

/** Returns the page of the first file in which a topic can be looked at; null where none is known. */
export function firstPlace(topic: MissionTopic, { recordings }: Topics, files: ReadonlyMap<string, TimelineFile>): RouteLocationRaw | null {
  const [first] = topic.recordings;
  const recording = recordings[first?.[0] ?? -1];
  const file = recording === undefined ? undefined : files.get(recording.id);
  return file === undefined ? null : { name: "file", params: { fileId: file.id }, query: { topic: topic.name } };
}

/** Returns for each recording the file of it that begins first. */
export function firstFiles(files: readonly TimelineFile[]): Map<string, TimelineFile> {
  const byId = new Map<string, TimelineFile>();
  for (const file of files) {
    if (file.recording_id === null || file.start_ns === null) continue;
    const known = byId.get(file.recording_id);
    if (known?.start_ns === undefined || known.start_ns === null || file.start_ns < known.start_ns) byId.set(file.recording_id, file);
  }
  return byId;
}
