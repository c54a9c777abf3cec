// Tables (CSV, TSV) and trajectories (TUM, KITTI) in bounded memory: the first rows as text, and columns of numbers.
import { READ_AHEAD } from "@/recordings/limits";
import { ReadFailure } from "@/recordings/failures";
import type { Source } from "@/recordings/ranges";

/** The beginning of a table that is read. Bytes. */
export const MAX_TABLE_BYTES = 8 * 1024 * 1024;
/** Rows that are read. */
export const MAX_ROW_COUNT = 500_000;
const STEP_BYTES = 64 * 1024;
/** Rows and columns that are shown as text. */
export const MAX_ROWS = 200;
export const MAX_SHOWN_COLUMNS = 50;
/** Columns whose numbers are offered as curves. */
export const MAX_NUMERIC_COLUMNS = 200;
const MAX_CELL = 200;
const MAX_RECORD = 1_000_000;
/** A column is numeric if this share of its cells that are not empty are numbers. */
const NUMERIC_SHARE = 0.9;
/** Cells without a value. */
const MISSING = /^\s*([+-]?nan)?\s*$/i;
const TUM = ["timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"];
const KITTI = ["r11", "r12", "r13", "tx", "r21", "r22", "r23", "ty", "r31", "r32", "r33", "tz"];

/** What separates the cells; " " is any white space. */
export type Delimiter = "," | ";" | "\t" | " ";

export interface NumericColumn {
  readonly name: string;
  /** A value for each row; NaN where a row has no number. */
  readonly values: readonly number[];
}

export interface Table {
  /** Of the shown columns. */
  readonly names: readonly string[];
  /** The number of columns of the widest row. */
  readonly columns: number;
  readonly rows: readonly (readonly string[])[];
  readonly rowCount: number;
  readonly numeric: readonly NumericColumn[];
  /** Whether the names are of a trajectory, in metres. */
  readonly isTrajectory: boolean;
  /** What was read of the file, in bytes. */
  readonly until: number;
}

/** Returns the delimiter of a table by its first line: the most frequent one outside of quotes. */
export function delimiterOf(head: string): Delimiter {
  const lines = head.split(/\r?\n/).map((line) => line.trim());
  const line = lines.find((one) => one !== "" && !one.startsWith("#")) ?? "";
  const plain = line.replaceAll(/"[^"]*"/g, "");
  const counts = ([",", ";", "\t"] as const).map((delimiter) => ({ delimiter, count: plain.split(delimiter).length - 1 }));
  const most = counts.reduce((best, item) => (item.count > best.count ? item : best));
  return most.count > 0 ? most.delimiter : " ";
}

/** Returns the cells of a record, whose quotes are closed. */
export function cellsOf(record: string, delimiter: Delimiter): string[] {
  if (delimiter === " ") return record.trim().split(/\s+/);
  if (!record.includes('"')) return record.split(delimiter);
  const cells: string[] = [];
  for (let at = 0; at <= record.length; ) {
    if (record[at] !== '"') {
      const end = endOfCell(record, delimiter, at);
      cells.push(record.slice(at, end));
      at = end + 1;
      continue;
    }
    const closing = closingQuote(record, at);
    const end = endOfCell(record, delimiter, closing);
    cells.push(record.slice(at + 1, closing).replaceAll('""', '"'));
    at = end + 1;
  }
  return cells;
}

function endOfCell(record: string, delimiter: string, at: number): number {
  const end = record.indexOf(delimiter, at);
  return end < 0 ? record.length : end;
}

function closingQuote(record: string, opening: number): number {
  let at = record.indexOf('"', opening + 1);
  while (at >= 0 && record[at + 1] === '"') at = record.indexOf('"', at + 2);
  return at < 0 ? record.length : at;
}

/** Collects a table from pieces of its text. */
export class TableReader {
  /** The record that is not complete; the lines before `counted` are, and leave its quotes open or not. */
  private rest = "";
  private counted = 0;
  private isOpen = false;
  private readonly hasQuotes: boolean;
  private comment = "";
  private header: readonly string[] | null = null;
  private isFirst = true;
  private readonly rows: (readonly string[])[] = [];
  rowCount = 0;
  private columns = 0;
  private readonly values: number[][] = [];
  /** By column, how many cells are not empty. */
  private readonly filled: number[] = [];

  constructor(private readonly delimiter: Delimiter) {
    this.hasQuotes = delimiter !== " ";
  }

  /** Add the next piece. @throws ReadFailure too_large, where a record is. */
  push(piece: string): void {
    const text = this.rest + piece;
    let start = 0;
    for (let end = text.indexOf("\n", this.rest.length); end >= 0; end = text.indexOf("\n", end + 1)) {
      if (this.hasQuotes && opensOrCloses(text, this.counted, end)) this.isOpen = !this.isOpen;
      this.counted = end + 1;
      if (this.isOpen && end - start <= MAX_RECORD) continue; // a line break within quotes
      this.add(text.slice(start, text[end - 1] === "\r" ? end - 1 : end));
      this.isOpen = false;
      start = end + 1;
    }
    this.rest = text.slice(start);
    this.counted -= start;
    if (this.rest.length > MAX_RECORD + STEP_BYTES) throw new ReadFailure("too_large", String(this.rest.length));
  }

  /** Return what was read; `isWhole`: the rest is a record, too. */
  finish(until: number, isWhole: boolean): Table {
    if (isWhole && this.rest !== "") this.add(this.rest);
    this.rest = "";
    const trajectory = this.delimiter !== " " || this.header !== null ? null : this.columns === TUM.length ? TUM : this.columns === KITTI.length ? KITTI : null;
    const nameOf = (column: number): string => (this.header?.[column] ?? trajectory?.[column] ?? "").trim().slice(0, MAX_CELL) || `column ${column + 1}`;
    const numeric = this.values.flatMap((values, column) => (isNumeric(values, this.filled[column] ?? 0) ? [{ name: nameOf(column), values: this.padded(values) }] : []));
    return {
      names: Array.from({ length: Math.min(this.columns, MAX_SHOWN_COLUMNS) }, (_, column) => nameOf(column)),
      columns: this.columns,
      rows: this.rows,
      rowCount: this.rowCount,
      numeric: withUniqueNames(numeric),
      isTrajectory: this.delimiter === " " && (this.columns === TUM.length || this.columns === KITTI.length),
      until,
    };
  }

  private add(record: string): void {
    const text = this.isFirst ? record.replace(/^\ufeff/, "") : record;
    this.isFirst = false;
    if (text.trim() === "") return;
    if (text.startsWith("#")) {
      if (this.rowCount === 0) this.comment = text.replace(/^#+\s*/, "");
      return;
    }
    const cells = cellsOf(text, this.delimiter);
    if (this.rowCount === 0 && this.header === null && this.takeHeader(cells)) return;
    this.columns = Math.max(this.columns, cells.length);
    if (this.rows.length < MAX_ROWS) this.rows.push(cells.slice(0, MAX_SHOWN_COLUMNS).map((cell) => cell.slice(0, MAX_CELL)));
    const numbers = Math.min(cells.length, MAX_NUMERIC_COLUMNS);
    for (let column = 0; column < numbers; column += 1) this.note(column, cells[column] ?? "");
    this.rowCount += 1;
  }

  /** Whether the first record has the names of the columns; the comment before it may have them instead. */
  private takeHeader(cells: readonly string[]): boolean {
    if (cells.every((cell) => Number.isNaN(numberOf(cell)))) {
      this.header = cells;
      this.columns = cells.length;
      return true;
    }
    const names = this.comment === "" ? [] : cellsOf(this.comment, this.delimiter);
    if (names.length === cells.length) this.header = names;
    return false;
  }

  private note(column: number, cell: string): void {
    const values = (this.values[column] ??= []);
    while (values.length < this.rowCount) values.push(NaN);
    values.push(numberOf(cell));
    this.filled[column] = (this.filled[column] ?? 0) + (MISSING.test(cell) ? 0 : 1);
  }

  private padded(values: readonly number[]): number[] {
    const missing = this.rowCount - values.length;
    return missing > 0 ? [...values, ...Array.from({ length: missing }, () => NaN)] : [...values];
  }
}

/** Whether the quotes of a part of a text leave a cell open, or close the one that was: their number is not even. */
function opensOrCloses(text: string, from: number, until: number): boolean {
  let count = 0;
  for (let at = text.indexOf('"', from); at >= 0 && at < until; at = text.indexOf('"', at + 1)) count += 1;
  return count % 2 === 1;
}

function numberOf(cell: string): number {
  const text = cell.trim();
  return text === "" ? NaN : Number(text);
}

function isNumeric(values: readonly number[], filled: number): boolean {
  const finite = values.reduce((count, value) => count + (Number.isFinite(value) ? 1 : 0), 0);
  return finite > 0 && finite >= NUMERIC_SHARE * filled;
}

/** Names that occur twice get the number of their column. */
function withUniqueNames(columns: readonly NumericColumn[]): NumericColumn[] {
  const names = new Set<string>();
  return columns.map((column, at) => {
    const name = names.has(column.name) ? `${column.name} (${at + 1})` : column.name;
    names.add(name);
    return { ...column, name };
  });
}

/** Read the beginning of a table, at most MAX_TABLE_BYTES and about MAX_ROW_COUNT rows, in steps between which the page responds. */
export async function readTable(source: Source, delimiter: Delimiter, onProgress: (until: number) => void): Promise<Table> {
  const reader = new TableReader(delimiter);
  const decoder = new TextDecoder();
  const limit = Math.min(source.sizeBytes, MAX_TABLE_BYTES);
  source.ahead = Math.min(READ_AHEAD, limit);
  try {
    let until = 0;
    while (until < limit && reader.rowCount < MAX_ROW_COUNT) {
      const end = Math.min(until + STEP_BYTES, limit);
      reader.push(decoder.decode(await source.read(until, end - until), { stream: end < source.sizeBytes }));
      until = end;
      onProgress(end);
      await new Promise((resolve) => setTimeout(resolve));
    }
    return reader.finish(until, until === source.sizeBytes);
  } finally {
    source.ahead = 0;
  }
}
