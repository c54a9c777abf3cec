// The log of a run as it is kept here: whole lines in pieces, found by their number. What one sees of 100 MB is some
// fifty lines, so a line is cut out of its piece only when it is drawn. Beyond a million lines the earliest are let go.
export const MOST_LINES = 1_000_000;
const MOST_SHOWN = 2_000;
/** A line that does not end is ended. */
const LONGEST = 65_536;
const MOST_FOUND = 10_000;
// eslint-disable-next-line no-control-regex -- which are what is taken out
const ESCAPES = /\u001b\[[0-9;?]*[A-Za-z]|[\u0000-\u0008\u000b-\u001f]/g;

interface Piece {
  readonly text: string;
  /** Where each of its lines begins. */
  readonly starts: Uint32Array;
  readonly first: number;
}

function startsOf(text: string): Uint32Array {
  const starts: number[] = [];
  for (let at = 0; at < text.length; ) {
    starts.push(at);
    const end = text.indexOf("\n", at);
    at = end < 0 ? text.length : end + 1;
  }
  return Uint32Array.from(starts);
}

/** Returns a line as a terminal would leave it: what it overwrote is gone, colours are not shown. */
export function shownLine(line: string, cut: string): string {
  const whole = line.endsWith("\r") ? line.slice(0, -1) : line;
  const last = whole.slice(whole.lastIndexOf("\r") + 1).replaceAll(ESCAPES, "");
  return last.length > MOST_SHOWN ? last.slice(0, MOST_SHOWN) + cut : last;
}

/** A log that grows. Lines have numbers from 0 on, which they keep when earlier ones are let go. */
export class LogLines {
  private pieces: Piece[] = [];
  /** A last line that does not end yet. */
  private open = "";
  private next = 0;
  private least = 0;

  constructor(private readonly most = MOST_LINES) {}

  /** The number of the earliest line that is kept. */
  get first(): number {
    return this.least;
  }

  /** The number after that of the last line. */
  get end(): number {
    return this.next + (this.open === "" ? 0 : 1);
  }

  append(text: string): void {
    const all = this.open.length > LONGEST ? `${this.open}\n${text}` : this.open + text;
    const end = all.lastIndexOf("\n") + 1;
    this.open = all.slice(end);
    if (end === 0) return;
    const piece = { text: all.slice(0, end), starts: startsOf(all.slice(0, end)), first: this.next };
    this.pieces.push(piece);
    this.next += piece.starts.length;
    while (this.pieces.length > 1 && this.next - (this.pieces[1]?.first ?? 0) >= this.most) this.pieces.shift();
    this.least = this.pieces[0]?.first ?? 0;
  }

  line(number: number): string {
    if (number >= this.next) return number === this.next ? this.open : "";
    const piece = this.pieces[this.pieceOf(number)];
    if (piece === undefined || number < piece.first) return "";
    const at = number - piece.first;
    return piece.text.slice(piece.starts[at], (piece.starts[at + 1] ?? piece.text.length) - 1);
  }

  /** Returns the numbers of the lines from `from` on in which a text is, whatever its case; and where to go on. */
  find(text: string, from: number): { readonly found: readonly number[]; readonly upTo: number } {
    const wanted = text.toLocaleLowerCase();
    const found: number[] = [];
    if (from >= this.next) return { found, upTo: from };
    const piece = this.pieces[this.pieceOf(Math.max(from, this.least))];
    if (piece === undefined || wanted === "") return { found, upTo: this.next };
    const within = piece.text.toLocaleLowerCase();
    for (let at = within.indexOf(wanted); at >= 0 && found.length < MOST_FOUND; ) {
      const line = lastAtMost(piece.starts, at);
      if (piece.first + line >= from) found.push(piece.first + line);
      at = within.indexOf(wanted, piece.starts[line + 1] ?? within.length);
    }
    return { found, upTo: piece.first + piece.starts.length };
  }

  private pieceOf(number: number): number {
    let [low, high] = [0, this.pieces.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if ((this.pieces[middle]?.first ?? 0) <= number) low = middle;
      else high = middle - 1;
    }
    return low;
  }
}

function lastAtMost(starts: Uint32Array, at: number): number {
  let [low, high] = [0, starts.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if ((starts[middle] ?? 0) <= at) low = middle;
    else high = middle - 1;
  }
  return low;
}
