// Tracks from the previews of recordings, where the messages themselves were not read.
import { unreadParts, type FilePart } from "./curves";
import type { SourceFile } from "./sources";
import type { Track, TrackPoint } from "./track";
import type { ReadPart } from "./useParts";
import type { Span } from "@/recordings/formats/recording";
import type { PreviewTrack } from "@/recordings/preview_file";
import { positionOf } from "@/recordings/products/location";

/** The track of a topic in one file. */
export interface FileTrack {
  readonly file: SourceFile;
  readonly track: PreviewTrack;
}

/** Returns the tracks in the parts that were not read. */
export function roughParts(previewed: readonly FileTrack[], read: readonly FilePart[]): ReadPart<Track>[] {
  return previewed.flatMap(({ file, track }) => unreadParts(file, read).map((part) => ({ ...part, fileId: file.id, content: trackWithin(part, track) })));
}

function trackWithin({ fromNs, toNs }: Span, { timesNs, positions }: PreviewTrack): Track {
  const points: TrackPoint[] = [];
  for (const [at, timeNs] of timesNs.entries()) {
    const [latitude = Number.NaN, longitude = Number.NaN, altitude = Number.NaN] = positions.subarray(3 * at, 3 * at + 3);
    const position = timeNs >= fromNs && timeNs <= toNs ? positionOf(latitude, longitude, altitude) : null;
    if (position !== null) points.push({ ...position, timeNs, isStart: points.length === 0 });
  }
  return { points, positions: points.length, stride: 1, missing: 0, isBroken: false };
}
