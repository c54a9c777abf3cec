// Texts of the preview of recordings.
import { counted, formatSize } from "@/components/format";
import type { FailureCode } from "@/recordings/failures";
import { MAX_VIDEO_FRAMES, MAX_VIDEO_NS } from "@/recordings/limits";
import type { DamagedPart } from "@/recordings/protocol";

interface FailureText {
  /** What is wrong. */
  readonly title: (detail: string) => string;
  /** What to do about it. */
  readonly remedy: string;
}

const DOWNLOAD = "Download the file and open it with other tools.";
const INSIDE = (detail: string) => (detail === "" ? "" : ` (${detail})`);

export const failures: Readonly<Record<FailureCode, FailureText>> = {
  no_index: {
    title: () => "This recording has no index, and its first part is not readable",
    remedy: DOWNLOAD,
  },
  not_readable_here: { title: () => "This file does not match its format", remedy: DOWNLOAD },
  compression_unknown: { title: (detail) => `The preview does not support the compression of its chunks${INSIDE(detail)}`, remedy: DOWNLOAD },
  too_large: {
    title: (detail) => `A part of this recording is too large for a browser${/^\d+$/.test(detail) ? ` (${formatSize(Number(detail))})` : ""}`,
    remedy: DOWNLOAD,
  },
  compressed_whole: {
    title: (detail) => `The whole file is compressed (${formatSize(Number(detail))}). To read any part, a browser would have to decompress all of it, which needs too much memory`,
    remedy: "Download it and run `zstd -d`, or read it with the Python SDK. Recordings with compressed chunks, such as MCAP with zstd, can be previewed at any size.",
  },
  chunk_damaged: { title: (detail) => `This part of the recording is damaged${INSIDE(detail)}`, remedy: "Try another time or topic. Other parts can be intact." },
  index_damaged: { title: (detail) => `The index of this recording is damaged${INSIDE(detail)}`, remedy: DOWNLOAD },
  topic_unknown: { title: () => "The index of the recording does not contain this topic", remedy: "Choose another topic." },
  topic_silent: { title: () => "This topic has no messages", remedy: "Choose another topic." },
  encoding_unknown: { title: (detail) => `The preview does not support the encoding of this topic${INSIDE(detail)}`, remedy: DOWNLOAD },
  definition_missing: {
    title: (detail) => `The recording does not contain the definition of this message type${INSIDE(detail)}`,
    remedy: "Record MCAP, or use ROS 2 Iron or later, which store definitions in databases, too.",
  },
  definition_unreadable: {
    title: (detail) => `The message definition of this topic is not readable${INSIDE(detail)}`,
    remedy: DOWNLOAD,
  },
  message_damaged: { title: (detail) => `A message does not match its definition${INSIDE(detail)}`, remedy: "Try another time or topic." },
  not_a_picture: { title: () => "Messages of this topic are not images", remedy: "Choose another topic." },
  picture_unreadable: { title: (detail) => `This image is not readable${INSIDE(detail)}`, remedy: "Try another time. Other images can be intact." },
  picture_too_large: { title: (detail) => `This image is too large to display (${detail})`, remedy: DOWNLOAD },
  pixels_unknown: { title: (detail) => `The preview does not support this image format${INSIDE(detail)}`, remedy: DOWNLOAD },
  video_insecure: {
    title: () => "Browsers decode video on pages with HTTPS only, or at localhost",
    remedy: "Open this page with HTTPS, or download the file.",
  },
  video_missing: { title: () => "This browser cannot decode video frames, because it has no WebCodecs", remedy: "Use a current version of Chrome, Edge, Firefox or Safari, or download the file." },
  video_codec: { title: (detail) => `This browser does not support the codec of this video${INSIDE(detail)}`, remedy: "Try another browser, or download the file and open it with other tools." },
  video_no_key_frame: {
    title: () => `Decoding begins with a key frame, and there is none shortly before this time (${MAX_VIDEO_FRAMES} frames or ${MAX_VIDEO_NS / 1_000_000_000n} s)`,
    remedy: "Try a later time.",
  },
  not_spatial: { title: (detail) => `Messages of this type are not shown in 3D${INSIDE(detail)}`, remedy: "Choose another topic." },
  cloud_unreadable: { title: (detail) => `These points are not readable${INSIDE(detail)}`, remedy: "Try another time. Other messages can be intact." },
  pose_unreadable: { title: () => "This message has no pose of finite numbers", remedy: "Try another time. Other messages can be intact." },
  grid_unreadable: { title: (detail) => `This grid is not readable${INSIDE(detail)}`, remedy: "Try another time. Other messages can be intact." },
  range_outside: { title: () => "Nothing was recorded in this time range", remedy: "Choose a time range within the recording." },
  not_sliceable: { title: (detail) => `A browser cannot make a slice of this recording: ${detail}`, remedy: "Run the command below instead." },
  not_saved: {
    title: (detail) => `The file could not be written${INSIDE(detail)}`,
    remedy: "Free some space on your disk or choose another folder, and try again.",
  },
  store_unreachable: {
    title: () => "The object store does not respond to this browser",
    remedy: "Check your network connection and try again. If downloads work, ask an admin to check the CORS rules of the store.",
  },
  store_refused: { title: (detail) => `The store rejected the request (status ${detail})`, remedy: "Try again. If the problem persists, contact an admin." },
  file_changed: { title: () => "The store returned a different file", remedy: "Reload the page. If the problem persists, contact an admin." },
  link_refused: { title: () => "The server returned no download URL", remedy: "Reload the page. Your right to read may have expired." },
  worker_ended: {
    title: () => "The reader stopped because it ran out of memory",
    remedy: "Try again with a shorter time range, or download the file.",
  },
  worker_silent: { title: () => "The reader took too long and was stopped", remedy: "Try again, or choose another topic." },
  cancelled: { title: () => "Reading was cancelled", remedy: "" },
};

/** Failures that can be temporary. */
export const worthAnotherTry: ReadonlySet<FailureCode> = new Set<FailureCode>([
  "store_unreachable", "store_refused", "file_changed", "link_refused", "worker_ended", "worker_silent", "cancelled",
]);

/** Why files of a format have no preview; null for formats that have one. */
export function whyNoPreview(format: string | null): string | null {
  if (format === "mcap" || format === "rosbag1" || format === "db3" || format === "ulog") return null;
  return "Previews are available for MCAP files, ROS 1 bags, rosbag2 databases and flight logs (ULog). Download the file to open it.";
}

export const texts = {
  title: "Preview",
  topic: "Topic",
  noTopics: "This recording has no messages.",
  noIndex: (until: number, size: number, isFlightLog: boolean) =>
    isFlightLog
      ? `A flight log has no index and is read from its beginning. The preview shows ${formatSize(until)} of ${formatSize(size)}.`
      : until < 0.9 * size
      ? `This recording was not closed and has no index. The preview shows its beginning: ${formatSize(until)} of ${formatSize(size)}.`
      : "This recording was not closed and has no index. The preview shows all readable data.",
  read: (bytes: number, size: number) => `${formatSize(bytes)} of ${formatSize(size)} read`,
  readTitle: "Amount of data that this page has read from the store",
  pictureOf: (topic: string, seconds: string, width: number, height: number) => `Image of ${topic} at ${seconds}, ${width} by ${height} pixels`,
  pictureAt: "Time",
  previous: "Previous image",
  next: "Next image",
  keys: "Arrow keys: previous and next image. Shift+arrow keys: one second. Page keys: one tenth of the recording.",
  size: (width: number, height: number) => `${width} × ${height}`,
  range: (least: string, greatest: string) => `black: ${least}, white: ${greatest}`,
  seconds: (seconds: number) => `${seconds.toFixed(3)} s`,
  secondsOf: (seconds: number, whole: number) => `${seconds.toFixed(3)} s of ${whole.toFixed(3)} s`,
  fields: "Fields",
  fieldsOf: (topic: string) => `Numeric fields of ${topic}`,
  noFields: "Messages of this topic have no numeric fields.",
  hidden: (count: number) => `and ${count} more`,
  mostFields: (count: number) => `Select at most ${count}.`,
  cancel: "Cancel",
  again: "Try again",
  damaged: (parts: readonly DamagedPart[]) => {
    const [first] = parts;
    if (first === undefined) return "";
    const span = first.toSeconds - first.fromSeconds < 0.001 ? `at ${first.fromSeconds.toFixed(3)} s` : `from ${first.fromSeconds.toFixed(3)} s to ${first.toSeconds.toFixed(3)} s`;
    return parts.length === 1
      ? `A part of this recording is damaged and not shown: ${span}.`
      : `${counted(parts.length, "part")} of this recording are damaged and not shown, the first ${span}.`;
  },
  partial: (seconds: string, whole: number) => `Showing the beginning, up to ${seconds}. The full range requires reading ${formatSize(whole)}.`,
  readAll: (whole: number) => `Read all ${formatSize(whole)}`,
  points: (messages: number, isWhole: boolean) =>
    isWhole ? `${counted(messages, "message")}, all shown` : `${counted(messages, "message")}, shown as minimum and maximum per pixel`,
  curve: (field: string, least: string, greatest: string) => `${field} from ${least} to ${greatest}`,
  plotOf: (topic: string, curves: string) => `Plot of ${topic} over time: ${curves}`,
  zoom: "Drag to zoom in. Double-click to reset.",
  showValues: "Show values",
  hideValues: "Hide values",
  valuesOf: (topic: string) => `Values of ${topic}`,
  saveCsv: "Save as CSV",
  secondsColumn: "Seconds",
  rows: (from: number, to: number, count: number) => `${from} to ${to} of ${count}`,
  earlier: "Previous page",
  later: "Next page",
} as const;
