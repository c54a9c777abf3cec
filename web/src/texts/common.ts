// Texts that several pages share.
import type { Span } from "@/components/time";

export const texts = {
  product: "Kleinkram",
  busy: "Working",
  loading: "Loading",
  notShown: "Cannot show this",
  close: "Close",
  cancel: "Cancel",
  save: "Save",
  again: "Try again",
  copy: "Copy",
  copied: "Copied",
  copyFailed: "The browser blocked copying. Select the text and copy it manually.",
  more: "More",
  none: "–",
  required: "required",
  selectAll: "Select all",
  selectRow: (name: string) => `Select ${name}`,
  selected: (count: number) => (count === 1 ? "1 selected" : `${count} selected`),
  clearSelection: "Clear selection",
  details: "Details",
  detailsOf: (name: string) => `Details of ${name}`,
  sortBy: (column: string) => `Sort by ${column}`,
  clearFilters: "Clear filters",
  filters: "Filters",
  undo: "Undo",
  dismiss: "Dismiss",
  saved: "I saved it",
  typeToConfirm: (word: string) => `Type ${word} to confirm`,
  breadcrumbs: "Breadcrumbs",
  severities: { error: "Error", warning: "Warning", info: "Info" },
  moreOfKind: (count: number) => `and ${count} more`,
  noAccess: {
    title: "You have no access yet",
    text: (lab: string, account: string) =>
      `You have no rights on any project. Ask a project owner or an admin of ${lab} to grant access to ${account}. The project then appears here.`,
  },
  columns: "Columns",
  bulk: {
    download: "Download",
    move: "Move",
    remove: "Delete",
    progress: (finished: number, total: number) => `${finished} of ${total} done`,
    failed: (failed: number, total: number) => `${failed} of ${total} failed:`,
    removeTitle: (count: number, noun: string) => `Delete ${count} ${noun}${count === 1 ? "" : "s"}?`,
    removeWhy: "They move to the trash. You can restore them for a limited time.",
    removed: (count: number, noun: string) => `${count} ${noun}${count === 1 ? "" : "s"} moved to the trash.`,
    moveTitle: (count: number, noun: string) => `Move ${count} ${noun}${count === 1 ? "" : "s"}`,
    moved: (count: number, noun: string) => `${count} ${noun}${count === 1 ? "" : "s"} moved.`,
    search: { mission: "Search projects by name", file: "Search missions by name" },
    to: "To",
  },
  cli: "Command line",
  sdk: "Python",
} as const;

const spans: Readonly<Record<Span, string>> = { 1: "Until tomorrow", 30: "For 30 days", 90: "For 90 days", 365: "For a year" };

export const untilTexts = { never: "No expiry", spans, day: "Until a date…", dayLabel: "Last day" } as const;
