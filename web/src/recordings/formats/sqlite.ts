/** Reads tables and indexes of an SQLite database by byte ranges, without SQLite: only the pages that are needed.
 *
 * Every number in a page is only a claim: nothing is read beyond the page and the file, and no page leads to itself.
 * Source: sqlite.org/fileformat2.html, sections 1.3 (header), 1.6 (b-tree pages), 2.1 (records).
 */

import { ReadFailure } from "../failures";
import { MAX_READ_AT_ONCE } from "../limits";
import type { ByteSource } from "../ranges";
import { joined, type Order } from "./recording";

const MAGIC = "SQLite format 3\0";
const HEADER_BYTES = 100;
const INTERIOR_INDEX = 2;
const INTERIOR_TABLE = 5;
const LEAF_INDEX = 10;
const LEAF_TABLE = 13;
const KINDS: ReadonlySet<number> = new Set([INTERIOR_INDEX, INTERIOR_TABLE, LEAF_INDEX, LEAF_TABLE]);
const MAX_LEVELS = 20;
/** Bytes of parsed pages that are cached. */
const MAX_CACHED_BYTES = 16 * 2 ** 20;
const FIXED_BYTES = [0, 1, 2, 3, 4, 6, 8, 8, 0, 0];
const TEXT = new TextDecoder();

export type SqlValue = bigint | number | string | Uint8Array | null;

/** A row of a table. Its columns are read on demand: that of a large value may be in many other pages. */
export interface Row {
  id: number;
  /** Where each column is in the payload. */
  columns: readonly Column[];
  payload: Payload;
}

/** An entry of an index: the indexed values and, at the end, the row id. */
export type Entry = readonly SqlValue[];

interface Column {
  serial: number;
  at: number;
  length: number;
}

interface Payload {
  /** The part in the page itself. */
  local: Uint8Array;
  length: number;
  overflowPage: number;
}

interface Cell {
  /** Zero in a leaf. */
  child: number;
  rowId: number;
  payload: Payload | null;
}

interface Page {
  kind: number;
  cells: readonly Cell[];
  /** The last child of an interior page. */
  right: number;
}

/** A table or index, by its first page. */
export interface Tree {
  name: string;
  table: string;
  kind: string;
  rootPage: number;
  sql: string;
}

export class SqliteFile {
  /** How often a page was read that was not cached. */
  pagesRead = 0;

  private readonly pages = new Map<number, Page>();

  private constructor(
    private readonly source: ByteSource,
    readonly pageBytes: number,
    private readonly usableBytes: number,
  ) {}

  /** @throws ReadFailure not_readable_here, index_damaged. */
  static async open(source: ByteSource): Promise<SqliteFile> {
    const head = await source.read(0, Math.min(HEADER_BYTES, source.sizeBytes));
    if (head.length < HEADER_BYTES || TEXT.decode(head.subarray(0, MAGIC.length)) !== MAGIC) throw new ReadFailure("not_readable_here");
    const view = new DataView(head.buffer, head.byteOffset, head.length);
    const claimed = view.getUint16(16);
    const pageBytes = claimed === 1 ? 65_536 : claimed;
    const usableBytes = pageBytes - view.getUint8(20);
    if (pageBytes < 512 || (pageBytes & (pageBytes - 1)) !== 0 || usableBytes < 480) throw damaged("its pages have no size");
    return new SqliteFile(source, pageBytes, usableBytes);
  }

  /** The tables and indexes of the schema. */
  async trees(): Promise<Tree[]> {
    const trees: Tree[] = [];
    for await (const row of this.rows(1)) {
      const [kind, name, table, rootPage, sql] = await this.values(row, [0, 1, 2, 3, 4]);
      if (typeof kind !== "string" || typeof name !== "string" || typeof table !== "string") continue;
      trees.push({ kind, name, table, rootPage: Number(rootPage ?? 0), sql: typeof sql === "string" ? sql : "" });
    }
    return trees;
  }

  /** All rows of a table, by row id. */
  async *rows(rootPage: number, levels = MAX_LEVELS): AsyncIterable<Row> {
    const page = await this.page(rootPage, INTERIOR_TABLE, LEAF_TABLE, levels);
    for (const cell of page.cells) {
      if (page.kind === INTERIOR_TABLE) yield* this.rows(cell.child, levels - 1);
      else yield row(cell);
    }
    if (page.kind === INTERIOR_TABLE) yield* this.rows(page.right, levels - 1);
  }

  /** The row with this id; null where there is none. */
  async row(rootPage: number, id: number): Promise<Row | null> {
    let number = rootPage;
    for (let levels = MAX_LEVELS; ; levels -= 1) {
      const page = await this.page(number, INTERIOR_TABLE, LEAF_TABLE, levels);
      const place = firstPlace(page.cells.length, (at) => (page.cells[at]?.rowId ?? 0) >= id);
      const cell = page.cells[place];
      if (page.kind === LEAF_TABLE) return cell?.rowId === id ? row(cell) : null;
      number = cell?.child ?? page.right;
    }
  }

  /** The entries of an index whose first value is within these numbers, in their order. */
  async *entries(rootPage: number, from: bigint, to: bigint, order: Order, levels = MAX_LEVELS): AsyncIterable<Entry> {
    const page = await this.page(rootPage, INTERIOR_INDEX, LEAF_INDEX, levels);
    const values = page.cells.map(({ payload }) => (payload === null ? [] : this.localValues(payload)));
    const isInterior = page.kind === INTERIOR_INDEX;
    const first = firstPlace(values.length, (at) => key(values[at]) >= from);
    const last = firstPlace(values.length, (at) => key(values[at]) > to);
    const isForward = order === "forward";
    // The child before a cell has the entries before it.
    for (let step = 0; step <= last - first; step += 1) {
      const place = isForward ? first + step : last - step;
      const child = page.cells[place]?.child ?? page.right;
      const entry = isForward ? values[place] : values[place - 1];
      const isWithin = isForward ? place < last : place > first;
      if (isInterior) yield* this.entries(child, from, to, order, levels - 1);
      if (isWithin && entry !== undefined) yield entry;
    }
  }

  /** First values of an index that divide it into parts of about equal size: `enough` of them or more, if it has them. */
  async dividers(rootPage: number, enough: number): Promise<bigint[]> {
    let level = [rootPage];
    let dividers: bigint[] = [];
    for (let levels = MAX_LEVELS; dividers.length < enough; levels -= 1) {
      const pages: Page[] = [];
      for (const number of level) pages.push(await this.page(number, INTERIOR_INDEX, LEAF_INDEX, levels));
      if (pages.some(({ kind }) => kind === LEAF_INDEX)) break;
      dividers = dividers.concat(pages.flatMap(({ cells }) => cells.map(({ payload }) => key(payload === null ? [] : this.localValues(payload)))));
      level = pages.flatMap(({ cells, right }) => [...cells.map(({ child }) => child), right]);
    }
    return dividers.sort((a, b) => (a < b ? -1 : a > b ? 1 : 0));
  }

  /** The value of a column; null for one that the row does not have. */
  async value(one: Row, number: number): Promise<SqlValue> {
    const column = one.columns[number];
    if (column === undefined) return null;
    const end = column.at + column.length;
    const bytes = end <= one.payload.local.length ? one.payload.local : await this.whole(one.payload);
    return valueOf(column.serial, bytes.subarray(column.at, end));
  }

  /** The values of several columns, read one after the other: a source has one reader at a time. */
  async values(one: Row, numbers: readonly number[]): Promise<SqlValue[]> {
    const values: SqlValue[] = [];
    for (const number of numbers) values.push(await this.value(one, number));
    return values;
  }

  /** Values of an entry that is in its page as a whole, as those of numbers are. */
  private localValues(payload: Payload): Entry {
    if (payload.local.length < payload.length) throw damaged("an entry of an index is too long");
    return columnsOf(payload).map(({ serial, at, length }) => valueOf(serial, payload.local.subarray(at, at + length)));
  }

  /** Reads a payload with its overflow pages, of which many follow each other in the file. */
  private async whole({ local, length, overflowPage }: Payload): Promise<Uint8Array> {
    if (length > Math.min(MAX_READ_AT_ONCE, this.source.sizeBytes)) throw new ReadFailure("too_large", String(length));
    const parts = [local];
    const capacity = this.usableBytes - 4;
    let missing = length - local.length;
    for (let next = overflowPage; missing > 0; ) {
      const start = (next - 1) * this.pageBytes;
      const count = Math.min(Math.ceil(missing / capacity), Math.floor((this.source.sizeBytes - start) / this.pageBytes));
      if (next < 2 || count < 1) throw damaged(`page ${next} lies beyond the end`);
      const bytes = await this.source.read(start, count * this.pageBytes);
      const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
      for (let at = 0, follows = true; follows && missing > 0; at += this.pageBytes) {
        const part = bytes.subarray(at + 4, at + 4 + Math.min(capacity, missing));
        parts.push(part);
        missing -= part.length;
        follows = view.getUint32(at) === next + 1 && at + this.pageBytes < bytes.length;
        next = view.getUint32(at);
      }
    }
    return joined(parts);
  }

  private async page(number: number, interior: number, leaf: number, levels: number): Promise<Page> {
    if (levels === 0) throw damaged(`page ${number} leads to itself`);
    const known = this.pages.get(number);
    const page = known ?? this.parse(number, await this.bytesOf(number));
    this.pages.delete(number);
    this.pages.set(number, page); // as the youngest
    for (const oldest of this.pages.keys()) {
      if (this.pages.size * this.pageBytes <= MAX_CACHED_BYTES) break;
      this.pages.delete(oldest);
    }
    if (page.kind !== interior && page.kind !== leaf) throw damaged(`page ${number} is of another kind`);
    return page;
  }

  private bytesOf(number: number): Promise<Uint8Array> {
    const start = (number - 1) * this.pageBytes;
    if (number < 1 || start + this.pageBytes > this.source.sizeBytes) throw damaged(`page ${number} lies beyond the end`);
    this.pagesRead += 1;
    return this.source.read(start, this.pageBytes);
  }

  private parse(number: number, bytes: Uint8Array): Page {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
    const start = number === 1 ? HEADER_BYTES : 0;
    const kind = view.getUint8(start);
    if (!KINDS.has(kind)) throw damaged(`page ${number} is not of a table or index`);
    const isInterior = kind === INTERIOR_INDEX || kind === INTERIOR_TABLE;
    const count = view.getUint16(start + 3);
    const first = start + (isInterior ? 12 : 8);
    if (first + 2 * count > this.usableBytes) throw damaged(`page ${number} claims ${count} cells`);
    const cells = Array.from({ length: count }, (_, place) => this.cell(kind, bytes, view, view.getUint16(first + 2 * place)));
    return { kind, cells, right: isInterior ? view.getUint32(start + 8) : 0 };
  }

  private cell(kind: number, bytes: Uint8Array, view: DataView, start: number): Cell {
    let at = start;
    const take = (): number => {
      const [value, next] = varint(view, at);
      at = next;
      return value;
    };
    const isInterior = kind === INTERIOR_INDEX || kind === INTERIOR_TABLE;
    if (start + 4 > this.usableBytes) throw damaged("a cell lies beyond its page");
    const child = isInterior ? view.getUint32(at) : 0;
    at += isInterior ? 4 : 0;
    if (kind === INTERIOR_TABLE) return { child, rowId: take(), payload: null };
    const length = take();
    const rowId = kind === LEAF_TABLE ? take() : 0;
    const localLength = this.localLength(length, kind === LEAF_TABLE);
    const end = at + localLength;
    const isWhole = localLength === length;
    if (end + (isWhole ? 0 : 4) > this.usableBytes) throw damaged("a row lies beyond its page");
    return { child, rowId, payload: { local: bytes.subarray(at, end), length, overflowPage: isWhole ? 0 : view.getUint32(end) } };
  }

  /** How much of a payload is in the page itself. */
  private localLength(length: number, isTable: boolean): number {
    const most = isTable ? this.usableBytes - 35 : Math.floor(((this.usableBytes - 12) * 64) / 255) - 23;
    if (length <= most) return length;
    const least = Math.floor(((this.usableBytes - 12) * 32) / 255) - 23;
    const local = least + ((length - least) % (this.usableBytes - 4));
    return local <= most ? local : least;
  }
}

function row({ rowId, payload }: Cell): Row {
  if (payload === null) throw damaged("a row without content");
  return { id: rowId, columns: columnsOf(payload), payload };
}

function columnsOf({ local, length }: Payload): Column[] {
  const view = new DataView(local.buffer, local.byteOffset, local.length);
  const [headerLength, first] = varint(view, 0);
  if (headerLength > local.length) throw damaged("the head of a row is not whole");
  const columns: Column[] = [];
  let valueAt = headerLength;
  for (let at = first; at < headerLength; ) {
    const [serial, next] = varint(view, at);
    const bytes = serial >= 12 ? (serial - (serial % 2 === 0 ? 12 : 13)) / 2 : FIXED_BYTES[serial];
    if (bytes === undefined) throw damaged(`a value of kind ${serial}`);
    columns.push({ serial, at: valueAt, length: bytes });
    valueAt += bytes;
    at = next;
  }
  if (valueAt > length) throw damaged("the values of a row are not whole");
  return columns;
}

/** Numbers of up to 4 bytes become numbers, larger ones bigints. */
function valueOf(serial: number, bytes: Uint8Array): SqlValue {
  if (serial >= 12) return serial % 2 === 0 ? bytes : TEXT.decode(bytes);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  if (serial === 7) return view.getFloat64(0);
  if (serial === 0) return null;
  if (serial >= 8) return serial - 8;
  if (serial === 6) return view.getBigInt64(0);
  if (serial === 5) return (BigInt(view.getInt16(0)) << 32n) | BigInt(view.getUint32(2));
  if (serial === 3) return (view.getInt8(0) << 16) | view.getUint16(1);
  return serial === 1 ? view.getInt8(0) : serial === 2 ? view.getInt16(0) : view.getInt32(0);
}

/** The first value of an entry; other values than whole numbers sort before them, as null does. */
function key(entry: Entry | undefined): bigint {
  const value = entry?.[0];
  if (typeof value === "bigint") return value;
  return typeof value === "number" && Number.isInteger(value) ? BigInt(value) : -1n;
}

/** The first place below `count` from which on a condition holds; `count` where it never does. */
function firstPlace(count: number, holds: (place: number) => boolean): number {
  let [low, high] = [0, count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (holds(middle)) high = middle;
    else low = middle + 1;
  }
  return low;
}

/** @throws ReadFailure index_damaged for a number beyond 2^53, and where it is not whole. */
function varint(view: DataView, start: number): [number, number] {
  let value = 0;
  for (let count = 0; count < 8; count += 1) {
    if (start + count >= view.byteLength) throw damaged("a number is not whole");
    const byte = view.getUint8(start + count);
    value = value * 128 + (byte & 127);
    if (value > Number.MAX_SAFE_INTEGER) break;
    if (byte < 128) return [value, start + count + 1];
  }
  throw damaged("a number is too large");
}

function damaged(detail: string): ReadFailure {
  return new ReadFailure("index_damaged", detail);
}
