// The words of home: what moved, what is unfinished, what needs somebody, what it all takes.
import type { components } from "@/api/schema";
import { counted, formatShare, formatSize } from "@/components/format";

type Need = components["schemas"]["Need"];

const needs: Readonly<Record<Need, (count: number) => string>> = {
  files_corrupt: (count) => `${counted(count, "file")} corrupt at the store`,
  files_lost: (count) => `${counted(count, "file")} lost from the store`,
  files_broken: (count) => `${counted(count, "file")} broken`,
  files_unread: (count) => `${counted(count, "file")} could not be read`,
  files_recovered: (count) => `${counted(count, "file")} damaged or never closed`,
  runs_cannot_start: (count) => `${counted(count, "run")} queued that no runner can start`,
  runs_failed: (count) => `${counted(count, "action")} failed`,
  metadata_missing: (count) => `${counted(count, "value")} of metadata missing or wrong`,
  scrub_stopped: () => "The store looks like another one: nothing was compared with it",
  verifications_overdue: (count) => `${counted(count, "file")} not verified in time`,
  jobs_failed: (count) => `${counted(count, "job")} failed`,
  disk_low: () => "The store’s disk is almost full",
};

export const texts = {
  title: "Home",
  upload: "Upload",
  search: "Search",

  missions: "Recent missions",
  allMissions: "All projects",
  columns: { mission: "Mission", files: "Files", size: "Size", when: "Last arrival" },

  uploads: "Your unfinished uploads",
  uploadsWhy: "Choose the same folder again: files that have arrived are not sent again.",
  goOn: "Go on",
  sent: (sent: number | null, whole: number) =>
    sent === null ? formatSize(whole) : `${formatSize(sent)} of ${formatSize(whole)}, ${formatShare(sent, whole)}`,
  lapses: "lapses",
  moreFiles: (count: number) => `and ${counted(count, "file")} more`,
  progress: (mission: string) => `Sent to ${mission}`,

  attention: "Needs attention",
  nothingNeeds: "Nothing needs you. All files that were read are whole.",
  need: (need: Need, count: number) => needs[need](count),
  where: (project: string, mission: string) => `${project} / ${mission}`,
  more: (count: number) => `${count} more`,
  fewer: "Fewer",

  storage: "Storage",
  quota: (used: number, quota: number) => `${formatSize(used)} of ${formatSize(quota)}`,
  files: (count: number) => counted(count, "file"),
  store: "The whole store",
  storeFree: (free: number) => `${formatSize(free)} free`,
  share: (name: string) => `Room that ${name} takes`,

  empty: "Nothing has been uploaded yet",
  emptyWhy: "Send a folder with recordings, from this page or from where they were recorded. Each mission belongs to a project; both are made as you go.",
  emptyCommand: "klein upload FOLDER/ -p PROJECT -m MISSION --create",
  emptyUpload: "Upload a first folder",
} as const;
