// What a page and the worker of its uploads say to each other.

import type { Report } from "./uploadQueue";
import type { JournalHead } from "./journal";
import type { PlannedFile } from "./types";

export type Command =
  | { readonly kind: "start"; readonly head: JournalHead; readonly files: readonly PlannedFile[] }
  | { readonly kind: "pause" | "go_on" | "cancel"; readonly id: string };

export type { Report };
