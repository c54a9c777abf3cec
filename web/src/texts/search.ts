// Texts of the search page.
import { counted, formatCount } from "@/components/format";

const facets: Readonly<Record<string, string>> = {
  project: "Project", format: "Format", content: "Content", month: "Month", label: "Label", topic: "Topic", type: "Message type", verdict: "Checks", check: "Failed check",
};

export const texts = {
  title: "Search",
  box: "Search files, missions, and topics",
  placeholder: "alps topic:/imu/* size>1GB -label:draft",
  try: "Examples",
  examples: ["topic:/camera/*", "size>1GB", "content:broken", "after:2026", "-label:draft", "verdict:bad", "event:stumble"],
  wrong: "Invalid search",
  emptyBox: "Clear search",

  tabs: { label: "Results", files: "Files", missions: "Missions", topics: "Topics", map: "Map" },
  estimated: "Many results: the counts are estimates, and the topics come from a sample of the files. Add a term to narrow the search.",
  files: "Matching files",
  missions: "Matching missions",
  topics: "Matching topics",
  columns: {
    file: "File", mission: "Mission", verdict: "Checks", content: "Content", labels: "Labels", event: "Event", start: "Recorded", size: "Size", files: "Files",
    topic: "Topic", type: "Type", messages: "Messages",
  },
  firstTopics: (shown: number, all: number) => `Showing the first ${formatCount(shown)} of ${counted(all, "topic")}. Add a term to narrow the search.`,

  facets: "Filters",
  facet: (name: string) => facets[name] ?? name.replace(/^meta\./, ""),
  chosen: "selected",
  allValues: (count: number) => `All ${formatCount(count)}`,
  fewerValues: "Show fewer",
  andMore: (count: number) => `and ${formatCount(count)} more`,
  sampled: (files: number) => `Counts from a sample of ${counted(files, "file")}.`,
  noFacets: "No filters for these results.",

  nothing: "No results",
  nothingWhy: "Remove a term, or enter part of a name. The search covers only what you have access to.",
  everything: "Nothing to search yet",
  everythingWhy: "Search covers names, notes, metadata, topics, message types, and times. Upload a folder first:",
  upload: "Upload",
  clear: "Search everything",

  command: "Search on the command line",
  download: "Download",
  downloadTitle: "Download results",
  saveScript: "Save as a script",
  scriptName: "download.sh",
  scriptHead: "Downloads the results of a Kleinkram search and verifies each file.",

  label: "Label",
  run: (missions: number) => (missions === 1 ? "Run on its mission…" : `Run on their ${missions} missions…`),
  share: "Share",
  shareOne: "A link can share files of one mission only.",
  labelTitle: (files: number) => `Labels of ${counted(files, "file")}`,
  add: "Add",
  addHint: "Separate labels with commas.",
  remove: "Remove",
  save: "Change labels",
  nothingToDo: "Enter a label, or select one to remove.",
  labelled: (files: number) => `Labels of ${counted(files, "file")} changed.`,
  refused: (files: number) => `${counted(files, "file")} not changed:`,
  tooMany: (most: number) => `Select at most ${most} files, or run klein file label --query.`,
} as const;
