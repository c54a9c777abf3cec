// What the viewer shows as a slice: the topics of its panels, in the files that have the range.
import type { Panel } from "./layout";
import type { ViewerTopic } from "./queries";
import type { SourceFile, SourceRecording } from "./sources";
import type { CutSelection } from "@/features/slice/selection";
import type { Span } from "@/recordings/formats/recording";
import { isTransformType } from "@/recordings/geometry/transforms";

export interface ViewSlice extends CutSelection {
  readonly topics: readonly string[];
  /** Names of the recordings. */
  readonly recordings: readonly string[];
  /** With the topics of their recordings that are shown. */
  readonly files: readonly { readonly file: SourceFile; readonly topics: readonly string[] }[];
}

/** Returns the slice of a range, null for all; the transforms, which 3D views of other programs need, are part of it. */
export function viewSlice(panels: readonly Panel[], topics: readonly ViewerTopic[], recordings: readonly SourceRecording[], range: Span | null): ViewSlice {
  const parts = recordings.flatMap(({ key, name, files }) => {
    const shown = topicsOf(panels, topics, key);
    const inRange = files.filter(({ span }) => range === null || (span.fromNs <= range.toNs && span.toNs >= range.fromNs));
    return shown.length === 0 || inRange.length === 0 ? [] : [{ name, shown, inRange }];
  });
  return {
    topics: [...new Set(parts.flatMap(({ shown }) => shown))],
    recordings: parts.map(({ name }) => name),
    files: parts.flatMap(({ shown, inRange }) => inRange.map((file) => ({ file, topics: shown }))),
    startNs: range?.fromNs ?? null,
    endNs: range === null ? null : range.toNs + 1n, // with the messages at the end of the range
  };
}

function topicsOf(panels: readonly Panel[], topics: readonly ViewerTopic[], recording: string): readonly string[] {
  const own = topics.filter((topic) => topic.recording === recording);
  const inPanels = new Set(panels.flatMap(({ series }) => series.filter((one) => one.recording === recording).map(({ topic }) => topic)));
  const shown = own.filter(({ name }) => inPanels.has(name)).map(({ name }) => name);
  return shown.length === 0 ? [] : [...new Set([...shown, ...own.filter(({ messageType }) => isTransformType(messageType)).map(({ name }) => name)])];
}
