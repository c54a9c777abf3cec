// Texts of the trash page.
import type { Trashed } from "@/api/types";
import { counted } from "@/components/format";

const nouns: Readonly<Record<Trashed["noun"], string>> = { project: "Project", mission: "Mission", file: "File" };

export const texts = {
  title: "Trash",
  lead: "Deleted objects that you can restore. On the date shown, they are deleted permanently.",
  label: "Trash",
  what: "Type",
  everything: "All types",
  only: { project: "Projects", mission: "Missions", file: "Files" },
  nouns,
  columns: { name: "Name", noun: "Type", holds: "Content", deleted: "Deleted", drops: "Deleted permanently", act: "Restore" },
  files: (count: number) => counted(count, "file"),
  by: (name: string) => `by ${name}`,
  restore: "Restore",
  restored: (name: string) => `${name} restored.`,
  open: "Open",
  empty: "The trash is empty.",
  emptyText: "Deleted objects stay here for a limited time.",
} as const;
