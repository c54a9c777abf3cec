// What is said of looking into recordings.
import { counted, formatSize } from "@/components/format";
import type { FailureCode } from "@/recordings/failures";
import type { DamagedPart } from "@/recordings/protocol";

interface Told {
  /** What is wrong. */
  readonly title: (detail: string) => string;
  /** What to do about it. */
  readonly remedy: string;
}

const DOWNLOAD = "Download the file to look at it with your own tools.";
const INSIDE = (detail: string) => (detail === "" ? "" : ` (${detail})`);

export const failures: Readonly<Record<FailureCode, Told>> = {
  no_index: {
    title: () => "This recording has no index, and its beginning does not tell what is in it",
    remedy: DOWNLOAD,
  },
  not_readable_here: { title: () => "This file is not what its format says", remedy: DOWNLOAD },
  compression_unknown: { title: (detail) => `Its chunks are compressed in a way that is not read here${INSIDE(detail)}`, remedy: DOWNLOAD },
  too_large: {
    title: (detail) => `A part of this recording is too large to hold in a browser${/^\d+$/.test(detail) ? ` (${formatSize(Number(detail))})` : ""}`,
    remedy: DOWNLOAD,
  },
  compressed_whole: {
    title: (detail) => `This file is compressed as a whole (${formatSize(Number(detail))}): all of it must be read and decompressed to see any of it, which is more than a browser can hold`,
    remedy: "Download it and run `zstd -d` on it, or read it with the Python SDK. A recording with compressed chunks inside, such as MCAP with zstd, can be looked into here whatever its size.",
  },
  chunk_damaged: { title: (detail) => `This part of the recording is damaged${INSIDE(detail)}`, remedy: "Try another time or topic: other parts may be whole." },
  index_damaged: { title: (detail) => `The index of this recording is damaged${INSIDE(detail)}`, remedy: DOWNLOAD },
  topic_unknown: { title: () => "The recording's own index does not know this topic", remedy: "Choose another topic." },
  topic_silent: { title: () => "This topic holds no message", remedy: "Choose another topic." },
  encoding_unknown: { title: (detail) => `Messages of this topic are written in a way that is not read here${INSIDE(detail)}`, remedy: DOWNLOAD },
  definition_unreadable: {
    title: (detail) => `The recording does not say how messages of this topic are made up${INSIDE(detail)}`,
    remedy: DOWNLOAD,
  },
  message_damaged: { title: (detail) => `A message does not fit its definition${INSIDE(detail)}`, remedy: "Try another time or topic." },
  not_a_picture: { title: () => "Messages of this topic are no pictures", remedy: "Choose another topic." },
  picture_unreadable: { title: (detail) => `This picture cannot be read${INSIDE(detail)}`, remedy: "Try another time: other pictures may be whole." },
  picture_too_large: { title: (detail) => `This picture is too large to show (${detail})`, remedy: DOWNLOAD },
  pixels_unknown: { title: (detail) => `Pictures of this kind are not shown here${INSIDE(detail)}`, remedy: DOWNLOAD },
  store_unreachable: {
    title: () => "The store of the bytes does not answer this browser",
    remedy: "Look at your network and try again. If downloads work and this does not, an admin should look at the store's rules for browsers (CORS).",
  },
  store_refused: { title: (detail) => `The store refused to give the bytes (status ${detail})`, remedy: "Try again; if it stays, tell an admin." },
  file_changed: { title: () => "The store gave other bytes than this file's", remedy: "Load the page anew; if it stays, tell an admin." },
  link_refused: { title: () => "The server gives no address for these bytes", remedy: "Load the page anew; your right to read may have ended." },
  worker_ended: {
    title: () => "The reader stopped: this recording took more than the browser gave it",
    remedy: "It is started anew when you try again. Ask for less at once, or download the file.",
  },
  worker_silent: { title: () => "The reader was busy for too long and was ended", remedy: "It is started anew when you try again, or choose another topic." },
  cancelled: { title: () => "Reading was ended", remedy: "" },
};

/** Failures that may be gone when one tries again. */
export const worthAnotherTry: ReadonlySet<FailureCode> = new Set<FailureCode>([
  "store_unreachable", "store_refused", "file_changed", "link_refused", "worker_ended", "worker_silent", "cancelled",
]);

/** Why files of a format cannot be looked into; null for formats that can. */
export function whyNot(format: string | null): string | null {
  if (format === "mcap" || format === "rosbag1") return null;
  if (format === "db3") {
    return "A rosbag2 database (db3) has no index that could be read from afar: finding anything takes the whole file. Download it, or record MCAP, which can be looked into here.";
  }
  return "This is no recording with an index that can be read from afar. Download the file to look at it.";
}

export const texts = {
  title: "First look",
  topic: "Topic",
  noTopics: "This recording holds no message.",
  mended: (until: number, size: number) =>
    until < 0.9 * size
      ? `This recording was never closed and has no index. This is its beginning: ${formatSize(until)} of ${formatSize(size)}.`
      : "This recording was never closed and has no index. This is what could be read of it.",
  read: (bytes: number, size: number) => `${formatSize(bytes)} of ${formatSize(size)} read`,
  readTitle: "What this page has fetched of the file, straight from the store",
  pictureOf: (topic: string, seconds: string, width: number, height: number) => `Picture of ${topic} at ${seconds}, ${width} by ${height} pixels`,
  pictureAt: "Time",
  previous: "Previous picture",
  next: "Next picture",
  keys: "Arrow keys go from picture to picture, with Shift by a second, Page keys by a tenth.",
  size: (width: number, height: number) => `${width} × ${height}`,
  range: (least: string, greatest: string) => `black is ${least}, white ${greatest}`,
  seconds: (seconds: number) => `${seconds.toFixed(3)} s`,
  secondsOf: (seconds: number, whole: number) => `${seconds.toFixed(3)} s of ${whole.toFixed(3)} s`,
  fields: "Fields",
  fieldsOf: (topic: string) => `Numeric fields of ${topic}`,
  noFields: "Messages of this topic hold no numbers to plot.",
  hidden: (count: number) => `and ${count} more`,
  mostFields: (count: number) => `At most ${count} at once.`,
  cancel: "Cancel",
  again: "Try again",
  damaged: (parts: readonly DamagedPart[]) => {
    const [first] = parts;
    if (first === undefined) return "";
    const span = first.toSeconds - first.fromSeconds < 0.001 ? `at ${first.fromSeconds.toFixed(3)} s` : `from ${first.fromSeconds.toFixed(3)} s to ${first.toSeconds.toFixed(3)} s`;
    return parts.length === 1
      ? `A part of this recording is damaged and left out: ${span}.`
      : `${counted(parts.length, "part")} of this recording are damaged and left out, the first ${span}.`;
  },
  partial: (seconds: string, whole: number) => `This is the beginning, up to ${seconds}. All of it needs ${formatSize(whole)} to be read.`,
  readAll: (whole: number) => `Read all ${formatSize(whole)}`,
  points: (messages: number, isWhole: boolean) =>
    isWhole ? `${counted(messages, "message")}, every one drawn` : `${counted(messages, "message")}, drawn by the least and greatest of each instant`,
  curve: (field: string, least: string, greatest: string) => `${field} from ${least} to ${greatest}`,
  plotOf: (topic: string, curves: string) => `Plot of ${topic} over time: ${curves}`,
  zoom: "Drag to look closer, double-click to go back.",
  showValues: "Show values",
  hideValues: "Hide values",
  valuesOf: (topic: string) => `Values of ${topic}`,
  saveCsv: "Save as CSV",
  secondsColumn: "Seconds",
  rows: (from: number, to: number, count: number) => `${from} to ${to} of ${count}`,
  earlier: "Earlier values",
  later: "Later values",
} as const;
