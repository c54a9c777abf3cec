// Texts that several pages share.
import type { Span } from "@/components/time";
import { counted } from "@/components/format";
import type { Trashed } from "@/api/types";

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
    to: { mission: "Project", file: "Mission" },
    moveOneTitle: { mission: "Move to another project", file: "Move to another mission" },
    moveWhy: {
      mission: "Files, recordings, and links move along. No data is copied. Access follows the new project, which can require other metadata.",
      file: "Links stay valid. Access follows the new mission. No data is copied.",
    },
    moveNone: { mission: "No matching project in which you can create missions.", file: "No matching mission that you can write to." },
    movedTo: (place: string) => `Moved to ${place}.`,
  },
  cli: "Command line",
  sdk: "Python",
} as const;

const spans: Readonly<Record<Span, string>> = { 1: "Until tomorrow", 30: "For 30 days", 90: "For 90 days", 365: "For a year" };

export const untilTexts = { never: "No expiry", spans, day: "Until a date…", dayLabel: "Last day" } as const;

/** Texts of the selection of missions, or of projects and missions. */
export const placeTexts = {
  missions: { legend: "Missions", find: "Find a mission", nothingFound: "No matching missions." },
  places: { legend: "Projects and missions", find: "Find a project or mission", nothingFound: "No matching projects or missions." },
  add: (name: string) => `Add ${name}`,
  remove: (name: string) => `Remove ${name}`,
} as const;

const resourceTypes: Readonly<Record<Trashed["resource_type"], string>> = { project: "Project", mission: "Mission", file: "File" };

export const trashTexts = {
  title: "Trash",
  lead: "Deleted objects that you can restore. On the date shown, they are deleted permanently.",
  label: "Trash",
  type: "Type",
  everything: "All types",
  only: { project: "Projects", mission: "Missions", file: "Files" },
  resourceTypes,
  columns: { name: "Name", resource_type: "Type", holds: "Content", deleted: "Deleted", drops: "Deleted permanently", act: "Restore" },
  files: (count: number) => counted(count, "file"),
  by: (name: string) => `by ${name}`,
  restore: "Restore",
  restored: (name: string) => `${name} restored.`,
  open: "Open",
  empty: "The trash is empty.",
  emptyText: "Deleted objects stay here for a limited time.",
} as const;
