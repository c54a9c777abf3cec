// Texts of downloads.
import { counted, formatShare, formatSize } from "@/components/format";

export const texts = {
  title: "Download",
  amount: (files: number, bytes: number) => `${counted(files, "file")}, ${formatSize(bytes)}`,
  folder: "Choose a folder…",
  folderWhy: "Each file is verified. Files that are already in the folder are not downloaded again. To resume an interrupted download, choose the same folder.",
  zip: "Download as ZIP",
  zipWhy: "This browser cannot write to a folder. You get one ZIP file.",
  zipTooLarge: (most: number) => `This browser cannot write to a folder, and a ZIP file over ${formatSize(most)} does not fit in memory. Use Chrome or Edge over HTTPS, or run this command:`,
  tooMany: (most: number) => `A browser can download at most ${counted(most, "file")} at once. Run this command:`,
  command: "Download on the command line",
  progress: (bytes: number, whole: number) => `${formatSize(bytes)} of ${formatSize(whole)}, ${formatShare(bytes, whole)}`,
  keepOpen: "Keep this window open during the download.",
  stop: "Stop",
  saved: (written: number, skipped: number) =>
    [`${counted(written, "file")} downloaded`, ...(skipped > 0 ? [`${counted(skipped, "file")} already present`] : [])].join(", ") + ".",
  failed: (count: number) => `${counted(count, "file")} could not be downloaded:`,
  stoppedZip: "Stopped. No ZIP file was created.",
  stopped: "Stopped. Choose the same folder to continue.",
  zipName: "kleinkram.zip",
  nothing: "No files to download.",
} as const;
