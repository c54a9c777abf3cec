// The words of uploading: the page, what is left out and why, how files end, and what to do.
import type { PathProblem } from "@/features/upload/engine/paths";

export const pathProblem: Readonly<Record<PathProblem["problem"], (detail: string) => string>> = {
  control: (code) => `its name holds the control character ${code}; rename it`,
  not_relative: () => "it has no name below a folder",
  backslash: () => "its name holds a backslash, which other systems read as a folder; rename it",
  too_long: (count) => `its path has ${count} characters; 1,024 are allowed`,
  too_many_bytes: (count) => `its path has ${count} bytes; 2,400 are allowed`,
  part: (part) => `its path holds the part “${part}”, which would leave or blur its place`,
  long_part: (count) => `a part of its path has ${count} bytes; 255 are allowed`,
};
