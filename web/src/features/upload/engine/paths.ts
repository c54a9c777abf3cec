// The rules for a file's path in its mission, as in `contract/names.py`: checked here so that a bad name is named before
// anything is read. The server has the last word.

const MAX_PATH_CHARACTERS = 1024;
const MAX_PATH_PART_BYTES = 255;
const MAX_PATH_BYTES = 2400;

const UNPRINTABLE = /[\p{Cc}\p{Cs}\p{Zl}\p{Zp}\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]/u;

/** What is wrong with a path; `detail` is what the sentence about it names. */
export interface PathProblem {
  readonly problem: "control" | "not_relative" | "backslash" | "too_long" | "too_many_bytes" | "part" | "long_part";
  readonly detail: string;
}

const encoder = new TextEncoder();

/** Return the form under which a path is unique. Full case folding is the server's; this tells apart what it does. */
export function nameKey(path: string): string {
  return path.normalize("NFC").toUpperCase().toLowerCase().normalize("NFC");
}

/** Return a path in NFC, or what is wrong with it. */
export function checkFilePath(given: string): string | PathProblem {
  const path = given.normalize("NFC");
  const bad = UNPRINTABLE.exec(path);
  if (bad !== null) {
    const code = bad[0].codePointAt(0) ?? 0;
    return { problem: "control", detail: `U+${code.toString(16).toUpperCase().padStart(4, "0")}` };
  }
  if (path === "" || path.startsWith("/") || path.endsWith("/")) return { problem: "not_relative", detail: "" };
  if (path.includes("\\")) return { problem: "backslash", detail: "" };
  const characters = Array.from(path).length;
  if (characters > MAX_PATH_CHARACTERS) return { problem: "too_long", detail: String(characters) };
  const bytes = Math.max(encoder.encode(path).length, encoder.encode(nameKey(path)).length);
  if (bytes > MAX_PATH_BYTES) return { problem: "too_many_bytes", detail: String(bytes) };
  for (const part of path.split("/")) {
    if (part === "" || part === "." || part === "..") return { problem: "part", detail: part };
    const partBytes = encoder.encode(part).length;
    if (partBytes > MAX_PATH_PART_BYTES) return { problem: "long_part", detail: String(partBytes) };
  }
  return path;
}
