// Text of a file in bounded pieces: which bytes are shown, decoding, blocks for the page, search, and formatted JSON.
import type { ByteSource } from "@/recordings/ranges";

/** How much is read at once, and how much is shown. Bytes. */
export const STEP_BYTES = 256 * 1024;
export const MAX_SHOWN_BYTES = 1024 * 1024;
/** The largest JSON that is formatted; what its formatted text may have, in characters. */
export const MAX_JSON_BYTES = 4 * 1024 * 1024;
const MAX_FORMATTED = 16 * 1024 * 1024;
const MAX_BLOCK_LINES = 200;
const MAX_BLOCK_LENGTH = 8_000;
export const MAX_MATCHES = 1_000;
const MAX_INDENT = 40;

/** The part of a file that is shown, in bytes. */
export interface Part {
  readonly from: number;
  readonly until: number;
}

export function firstPart(size: number): Part {
  return { from: 0, until: Math.min(size, STEP_BYTES) };
}

export function lastPart(size: number): Part {
  return { from: Math.max(0, size - STEP_BYTES), until: size };
}

/** Returns the part with more of the file behind it; what exceeds the bound at its beginning is left out. */
export function withLater({ from, until }: Part, size: number): Part {
  const end = Math.min(size, until + STEP_BYTES);
  return { from: Math.max(from, end - MAX_SHOWN_BYTES), until: end };
}

export function withEarlier({ from, until }: Part): Part {
  const start = Math.max(0, from - STEP_BYTES);
  return { from: start, until: Math.min(until, start + MAX_SHOWN_BYTES) };
}

export interface Decoded {
  readonly text: string;
  /** Sequences of bytes that are not UTF-8, shown as U+FFFD. */
  readonly invalid: number;
}

/** Returns the text of a part; a character that its ends cut is left out. */
export async function readText(source: ByteSource, { from, until }: Part): Promise<Decoded> {
  const bytes = await source.read(from, until - from);
  let start = 0;
  while (from > 0 && start < 3 && ((bytes[start] ?? 0) & 0xc0) === 0x80) start += 1;
  return decode(bytes.subarray(start), until < source.sizeBytes);
}

function decode(bytes: Uint8Array, isCut: boolean): Decoded {
  try {
    return { text: new TextDecoder("utf-8", { fatal: true }).decode(bytes, { stream: isCut }), invalid: 0 };
  } catch {
    const text = new TextDecoder().decode(bytes, { stream: isCut });
    return { text, invalid: text.split("\ufffd").length - 1 };
  }
}

/** Returns a text with a visible sign for each control character, and for those that change the direction of text. */
export function visible(text: string): string {
  // eslint-disable-next-line no-control-regex -- they are what is replaced
  return text.replace(/[\u0000-\u0008\u000b-\u001f\u007f\u202a-\u202e\u2066-\u2069]/g, (letter) => {
    const code = letter.charCodeAt(0);
    if (code > 0x7f) return `⟨U+${code.toString(16).toUpperCase()}⟩`;
    return code === 0x7f ? "␡" : String.fromCharCode(0x2400 + code);
  });
}

/** A piece of the text that the browser lays out as a whole; `from`: its offset in the text. */
export interface TextBlock {
  readonly from: number;
  readonly text: string;
}

/** Returns the blocks of a text: whole lines where they are short. */
export function blocksOf(text: string): TextBlock[] {
  const blocks: TextBlock[] = [];
  let from = 0;
  let lines = 0;
  let end = 0; // of the last whole line of the block
  function close(at: number): void {
    blocks.push({ from, text: text.slice(from, at) });
    [from, lines, end] = [at, 0, at];
  }
  while (end < text.length) {
    const newline = text.indexOf("\n", end);
    const next = newline < 0 ? text.length : newline + 1;
    if (next - from > MAX_BLOCK_LENGTH && end > from) close(end);
    while (next - from > MAX_BLOCK_LENGTH) close(from + wholeLength(text, from));
    end = next;
    lines += 1;
    if (lines === MAX_BLOCK_LINES) close(end);
  }
  if (from < text.length) close(text.length);
  return blocks;
}

/** The length of a block inside of a long line: it does not divide a pair of surrogates. */
function wholeLength(text: string, from: number): number {
  const last = text.charCodeAt(from + MAX_BLOCK_LENGTH - 1);
  return last >= 0xd800 && last < 0xdc00 ? MAX_BLOCK_LENGTH - 1 : MAX_BLOCK_LENGTH;
}

/** Where a term occurs in a text, regardless of case, up to MAX_MATCHES. */
export function matchesOf(text: string, term: string): number[] {
  if (term === "") return [];
  const pattern = new RegExp(term.replace(/[.*+?^${}()|[\]\\/-]/g, "\\$&"), "gi");
  const matches: number[] = [];
  for (let match = pattern.exec(text); match !== null && matches.length < MAX_MATCHES; match = pattern.exec(text)) matches.push(match.index);
  return matches;
}

/** A piece of a block; `match`: the number of the match that it belongs to. */
export interface Segment {
  readonly text: string;
  readonly match: number | null;
}

/** Returns a block as segments, given where matches of `length` characters begin in the text, in order. */
export function segmentsOf({ from, text }: TextBlock, matches: readonly number[], length: number): Segment[] {
  const segments: Segment[] = [];
  let at = 0;
  for (let match = firstAfter(matches, from - length); match < matches.length; match += 1) {
    const start = Math.max(0, (matches[match] ?? 0) - from);
    const end = Math.min(text.length, (matches[match] ?? 0) + length - from);
    if (start >= text.length) break;
    if (start > at) segments.push({ text: text.slice(at, start), match: null });
    segments.push({ text: text.slice(start, end), match });
    at = end;
  }
  if (at < text.length) segments.push({ text: text.slice(at), match: null });
  return segments;
}

/** The number of the first match that begins after an offset. */
function firstAfter(matches: readonly number[], offset: number): number {
  let [low, high] = [0, matches.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((matches[middle] ?? 0) > offset) high = middle;
    else low = middle + 1;
  }
  return low;
}

/** The tokens of valid JSON. */
function* tokensOf(text: string): Generator<string> {
  const plain = /[^\s{}[\],:"]+/y;
  for (let at = 0; at < text.length; ) {
    const letter = text[at] ?? "";
    plain.lastIndex = at;
    const end = letter === '"' ? endOfString(text, at) : "{}[],:".includes(letter) ? at + 1 : plain.test(text) ? plain.lastIndex : at;
    if (end > at) yield text.slice(at, end);
    at = Math.max(end, at + 1);
  }
}

/** Where the string that begins at `at` ends. */
function endOfString(text: string, at: number): number {
  for (let quote = text.indexOf('"', at + 1); quote >= 0; quote = text.indexOf('"', quote + 1)) {
    let slash = quote - 1;
    while (text[slash] === "\\") slash -= 1;
    if ((quote - slash) % 2 === 1) return quote + 1;
  }
  return text.length;
}

/** Returns JSON with one value a line. Numbers keep all digits. Null: it is not JSON, or its formatted text is too long. */
export function formatJson(text: string): string | null {
  try {
    JSON.parse(text);
  } catch {
    return null;
  }
  const parts: string[] = [];
  let [depth, length, before] = [0, 0, ""];
  for (const token of tokensOf(text)) {
    const closes = token === "}" || token === "]";
    if (closes) depth -= 1;
    const isEmpty = closes && (before === "{" || before === "[");
    const breaks = before === "," || (closes && !isEmpty) || (!closes && (before === "{" || before === "["));
    const part = `${breaks ? `\n${"  ".repeat(Math.min(depth, MAX_INDENT))}` : ""}${token}${token === ":" ? " " : ""}`;
    length += part.length;
    if (length > MAX_FORMATTED) return null;
    parts.push(part);
    if (token === "{" || token === "[") depth += 1;
    before = token;
  }
  return parts.join("");
}
