// What the page knows of a file before it shows its content, and the interface of viewers. To add a viewer for a kind of
// file, write one component in `viewers/` that exports `viewer`.
import type { File } from "@/api/types";
import type { Ranges } from "@/recordings/ranges";

/** How much of the beginning of a file decides on its viewer, in bytes. */
export const HEAD_BYTES = 4096;
/** A text may contain this share of characters that are invalid or control characters. */
const MAX_INVALID = 0.1;

export interface Content {
  readonly path: string;
  /** The part of the name behind its last dot, in lower case; empty without one. */
  readonly ending: string;
  /** The format that the server detected. */
  readonly format: string | null;
  readonly head: Uint8Array;
  readonly isText: boolean;
}

export interface FileViewer {
  /** Its name in the address of the page. */
  readonly name: string;
  readonly label: string;
  /** How well it shows a file: the viewer with the highest rank is the default; 0: it cannot show it. */
  readonly rank: (content: Content) => number;
}

/** The props of a viewer. `ranges` reads the file, and stops when the page is left. */
export interface ViewerProps {
  readonly file: File;
  readonly content: Content;
  readonly ranges: Ranges;
}

/** Returns whether bytes begin with others, from an offset on. */
export function hasBytes(bytes: Uint8Array, expected: readonly number[] | string, offset = 0): boolean {
  const values = typeof expected === "string" ? Array.from(expected, (letter) => letter.charCodeAt(0)) : expected;
  return values.every((value, at) => bytes[offset + at] === value);
}

/** Returns whether the beginning of a file is text in UTF-8, or nearly so. */
export function isText(head: Uint8Array): boolean {
  if (head.includes(0)) return false;
  const text = new TextDecoder().decode(head, { stream: true }); // a character may be cut at the end
  // eslint-disable-next-line no-control-regex -- they are what is counted
  const invalid = text.match(/[\u0000-\u0008\u000e-\u001a\u001c-\u001f\ufffd]/g)?.length ?? 0;
  return invalid <= MAX_INVALID * text.length;
}

export function contentOf(path: string, format: string | null, head: Uint8Array): Content {
  const name = path.slice(path.lastIndexOf("/") + 1);
  const ending = name.includes(".") ? name.slice(name.lastIndexOf(".") + 1).toLowerCase() : "";
  return { path, ending, format, head, isText: isText(head) };
}

/** Formats of recordings: their viewers show topics, and where they cannot be read, the page says why. */
const RECORDINGS: ReadonlySet<string | null> = new Set(["mcap", "rosbag1", "rosbag1-old", "db3", "ulog", "svo2", "zstd"]);

/** Returns whether a file is shown by a viewer of files. */
export function isContent({ format }: File): boolean {
  return !RECORDINGS.has(format);
}
