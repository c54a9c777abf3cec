// Texts of the home page.
import type { components } from "@/api/schema";
import { counted, formatShare, formatSize } from "@/components/format";

type AttentionKind = components["schemas"]["AttentionKind"];

const kinds: Readonly<Record<AttentionKind, (count: number) => string>> = {
  files_corrupt: (count) => `${counted(count, "file")} corrupt in the store`,
  files_lost: (count) => `${counted(count, "file")} missing from the store`,
  files_broken: (count) => `${counted(count, "file")} broken`,
  files_unread: (count) => `${counted(count, "file")} not read because of an error`,
  files_recovered: (count) => `${counted(count, "file")} recovered (damaged or not closed)`,
  runs_cannot_start: (count) => `${counted(count, "run")} queued without a suitable runner`,
  runs_failed: (count) => `${counted(count, "action")} failed`,
  metadata_missing: (count) => `${counted(count, "metadata value")} missing or invalid`,
  scrub_stopped: () => "Scrub stopped: the store seems to be a different one",
  verifications_overdue: (count) => `${counted(count, "file")} overdue for verification`,
  jobs_failed: (count) => `${counted(count, "job")} failed`,
  disk_low: () => "The store’s disk is almost full",
};

export const texts = {
  title: "Home",
  upload: "Upload",
  search: "Search",

  missions: "Recent missions",
  allMissions: "All projects",
  columns: { mission: "Mission", files: "Files", size: "Size", when: "Last upload" },

  uploads: "Your unfinished uploads",
  uploadsWhy: "To resume, choose the same folder again. Uploaded files are not sent again.",
  resume: "Resume",
  sent: (sent: number | null, whole: number) =>
    sent === null ? formatSize(whole) : `${formatSize(sent)} of ${formatSize(whole)}, ${formatShare(sent, whole)}`,
  expires: "expires",
  moreFiles: (count: number) => `and ${counted(count, "file")} more`,
  progress: (mission: string) => `Upload progress for ${mission}`,

  failedChecks: (count: number) => `${counted(count, "mission")} failed checks since Monday`,
  allBad: "All bad missions",

  attention: "Needs attention",
  nothingNeeds: "Nothing needs attention.",
  kind: (kind: AttentionKind, count: number) => kinds[kind](count),
  where: (project: string, mission: string) => `${project} / ${mission}`,
  more: (count: number) => `Show ${count} more`,
  fewer: "Show fewer",

  storage: "Storage",
  quota: (used: number, quota: number) => `${formatSize(used)} of ${formatSize(quota)}`,
  files: (count: number) => counted(count, "file"),
  store: "Entire store",
  storeFree: (free: number) => `${formatSize(free)} free`,
  share: (name: string) => `Storage used by ${name}`,

  empty: "Nothing has been uploaded yet",
  emptyWhy: "Upload a folder of recordings here or from the robot. The upload creates the project and the mission.",
  emptyCommand: "klein upload FOLDER/ -p PROJECT -m MISSION --create",
  emptyUpload: "Upload a folder",
} as const;
