// The words of downloads.
import { counted, formatShare, formatSize } from "@/components/format";

export const texts = {
  title: "Download",
  amount: (files: number, bytes: number) => `${counted(files, "file")}, ${formatSize(bytes)}`,
  folder: "Choose a folder …",
  folderWhy: "Each file is checked before it gets its name. Files that are in the folder already are not fetched again, so after a break the same folder continues the download.",
  zip: "Download as a zip",
  zipWhy: "This browser cannot write into a folder, so all files come in one zip.",
  zipTooLarge: (most: number) => `This browser cannot write into a folder, and a zip of more than ${formatSize(most)} does not fit into it. Use Chrome or Edge over HTTPS, or the command:`,
  tooMany: (most: number) => `A browser downloads at most ${counted(most, "file")} at once. Use the command:`,
  command: "The same on the command line",
  progress: (bytes: number, whole: number) => `${formatSize(bytes)} of ${formatSize(whole)}, ${formatShare(bytes, whole)}`,
  keepOpen: "Closing this window stops the download.",
  stop: "Stop",
  saved: (written: number, skipped: number) =>
    [`${counted(written, "file")} written`, ...(skipped > 0 ? [`${counted(skipped, "file")} were there already`] : [])].join(", ") + ".",
  failed: (count: number) => `${counted(count, "file")} could not be downloaded:`,
  stoppedZip: "Stopped. No zip was made.",
  stopped: "Stopped. Choose the same folder to continue.",
  zipName: "kleinkram.zip",
  nothing: "There are no files in it.",
} as const;
