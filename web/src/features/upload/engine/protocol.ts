// What a page and the worker of its uploads say to each other.

import type { Report } from "./desk";
import type { JournalHead } from "./journal";
import type { PlannedFile } from "./nouns";

export type Command =
  | { readonly kind: "start"; readonly head: JournalHead; readonly files: readonly PlannedFile[] }
  | { readonly kind: "pause" | "go_on" | "cancel"; readonly id: string };

export type { Report };
