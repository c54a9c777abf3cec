// The words of the search: what is typed, what is found, what is done with it.
import { counted, formatCount } from "@/components/format";

const facets: Readonly<Record<string, string>> = {
  project: "Project", format: "Format", content: "Content", month: "Month", label: "Label", topic: "Topic", type: "Message type",
};

export const texts = {
  title: "Search",
  box: "Search files, missions and topics",
  placeholder: "alps topic:/imu/* size>1GB -label:draft",
  try: "For example",
  examples: ["topic:/camera/*", "size>1GB", "content:broken", "after:2026", "-label:draft"],
  wrong: "This cannot be read",
  emptyBox: "Empty the box",

  tabs: { label: "What was found", files: "Files", missions: "Missions", topics: "Topics" },
  estimated: "Very much was found: these numbers are estimates, and the topics are those of files drawn by lot. A word more finds less.",
  files: "Files that were found",
  missions: "Missions that were found",
  topics: "Topics that were found",
  columns: {
    file: "File", mission: "Mission", content: "Content", labels: "Labels", start: "Recorded", size: "Size", files: "Files",
    topic: "Topic", type: "Type", messages: "Messages",
  },
  firstTopics: (shown: number, all: number) => `The first ${formatCount(shown)} of ${counted(all, "topic")}; a word more finds fewer.`,

  facets: "Narrow down",
  facet: (name: string) => facets[name] ?? name.replace(/^meta\./, ""),
  chosen: "chosen",
  allValues: (count: number) => `All ${formatCount(count)}`,
  fewerValues: "Fewer",
  andMore: (count: number) => `and ${formatCount(count)} more`,
  sampled: (files: number) => `Counted among ${counted(files, "file")} of those found.`,
  noFacets: "Nothing here divides what was found.",

  nothing: "Nothing matches",
  nothingWhy: "Take a term away, or write a part of a name. Only what you may see is found.",
  everything: "There is nothing to be found yet",
  everythingWhy: "What you upload is found here by its names, notes, metadata, topics, types and times. Send a first folder:",
  upload: "Upload",
  clear: "Search everything",

  command: "The same on the command line",
  download: "Download",
  downloadTitle: "Download what was found",
  saveScript: "Save as a script",
  scriptName: "download.sh",
  scriptHead: "Fetches what a search in Kleinkram found, each file verified.",

  label: "Label",
  run: (missions: number) => (missions === 1 ? "Run on its mission …" : `Run on their ${missions} missions …`),
  share: "Share",
  shareOne: "A link shows files of one mission; these are of several.",
  labelTitle: (files: number) => `Labels of ${counted(files, "file")}`,
  add: "Add",
  addHint: "Several are parted by commas.",
  remove: "Take away",
  save: "Change labels",
  nothingToDo: "Write a label, or choose one to take away.",
  labelled: (files: number) => `The labels of ${counted(files, "file")} were changed.`,
  refused: (files: number) => `${counted(files, "file")} stayed as they were:`,
  tooMany: (most: number) => `At most ${most} files at once; select fewer, or use klein file label --query.`,
} as const;
