// Texts of downloads of a part of a recording.
import { counted, formatSize } from "@/components/format";

export const texts = {
  title: "Download selection",
  why: "Choose topics and a time range. You get them as an MCAP file; only the parts of the recording that contain them are read.",
  partOf: (name: string, files: number) => `This is one of the ${files} files of the recording ${name}, and the selection is of this file alone. To select from all of them, run:`,
  several: "To take topics or a time range out of them as one MCAP file, run:",
  topics: "Topics of the selection",
  topic: "Topic",
  count: "Messages",
  size: "Size",
  range: "Time range",
  from: "From, in seconds after the start",
  to: "To, in seconds after the start",
  whole: "Whole recording",
  estimate: (topics: number, bytes: number) => `${counted(topics, "topic")}, about ${formatSize(bytes)} before compression`,
  nothing: "Choose at least one topic and a time range.",
  save: "Save as…",
  download: "Download",
  inMemory: (most: number) => `This browser cannot write to a file while it downloads. A selection of more than ${formatSize(most)} does not fit in memory; use Chrome or Edge over HTTPS, or the command below.`,
  latchedWhy: "A selection with a later start begins with the last messages of latched topics, such as static transforms and maps.",
  progress: (written: number, read: number) => `${formatSize(written)} written, ${formatSize(read)} read`,
  keepOpen: "Keep this window open during the download.",
  stop: "Stop",
  stopped: "Stopped. Nothing was kept.",
  saved: (messages: number, bytes: number) => `${counted(messages, "message")} saved, ${formatSize(bytes)}.`,
  command: "The same on the command line",
} as const;
