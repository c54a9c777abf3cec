// The words of the trash.
import type { Trashed } from "@/api/types";
import { counted } from "@/components/format";

const nouns: Readonly<Record<Trashed["noun"], string>> = { project: "Project", mission: "Mission", file: "File" };

export const texts = {
  title: "Trash",
  lead: "What was deleted, of all that you may delete. It can be put back until the day it is dropped; then its bytes go too.",
  label: "What lies in the trash",
  what: "What",
  everything: "Everything",
  only: { project: "Projects", mission: "Missions", file: "Files" },
  nouns,
  columns: { name: "Name", noun: "What", holds: "Holds", deleted: "Deleted", drops: "Dropped", act: "Put back" },
  files: (count: number) => counted(count, "file"),
  by: (name: string) => `by ${name}`,
  restore: "Put back",
  restored: (name: string) => `${name} is back.`,
  open: "Open",
  empty: "The trash is empty.",
  emptyText: "What somebody deletes lies here for a while before it is dropped for good.",
} as const;
