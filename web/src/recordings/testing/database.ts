/** Small rosbag2 databases for tests, written page by page (sqlite.org/fileformat2.html). */

import { joined } from "../formats/recording";

export const PAGE = 1024;
const TEXT = new TextEncoder();
const LEAF_TABLE = { kind: 13, most: PAGE - 35 };
const LEAF_INDEX = { kind: 10, most: Math.floor(((PAGE - 12) * 64) / 255) - 23 };
const LEAST = Math.floor(((PAGE - 12) * 32) / 255) - 23;

type Cell = number | bigint | string | Uint8Array | null;

export interface TestTopic {
  id: number;
  name: string;
  type: string;
}

export interface TestRow {
  topicId: number;
  timeNs: bigint;
  data: Uint8Array;
}

export interface DatabaseOptions {
  hasIndex?: boolean;
  /** Texts of `ros2msg` by type. */
  definitions?: Readonly<Record<string, string>>;
}

/** A database with these rows, whose pages have 1024 bytes. */
export function madeDb3(topics: readonly TestTopic[], rows: readonly TestRow[], { hasIndex = true, definitions }: DatabaseOptions = {}): Uint8Array {
  const pages = new Pages();
  const schema: Cell[][] = [];
  const table = (name: string, columns: string, content: readonly (readonly [number, readonly Cell[]])[]): void => {
    const root = pages.table(content);
    schema.push(["table", name, name, root, `CREATE TABLE ${name}(id INTEGER PRIMARY KEY,${columns})`]);
  };
  table("topics", "name TEXT NOT NULL,type TEXT NOT NULL,serialization_format TEXT NOT NULL", topics.map(({ id, name, type }) => [id, [null, name, type, "cdr"]]));
  table("messages", "topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL", rows.map(({ topicId, timeNs, data }, at) => [at + 1, [null, topicId, timeNs, data]]));
  if (definitions !== undefined) {
    const texts = Object.entries(definitions).map(([type, text], at) => [at + 1, [null, type, "ros2msg", text, ""]] as const);
    table("message_definitions", "topic_type TEXT NOT NULL, encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL", texts);
  }
  if (hasIndex) {
    const order = rows.map(({ timeNs }, at) => [timeNs, at + 1] as const).sort((a, b) => (a[0] < b[0] ? -1 : a[0] > b[0] ? 1 : a[1] - b[1]));
    schema.push(["index", "timestamp_idx", "messages", pages.index(order), "CREATE INDEX timestamp_idx ON messages (timestamp ASC)"]);
  }
  return pages.file(schema);
}

class Pages {
  private readonly made: Uint8Array[] = [new Uint8Array(PAGE)]; // the first one is that of the schema

  table(rows: readonly (readonly [number, readonly Cell[]])[]): number {
    const cells = rows.map(([id, values]) => ({ id, bytes: this.payload(record(values), LEAF_TABLE.most, [varint(id)]) }));
    let level = grouped(cells, ({ bytes }) => bytes.length).map((group) => {
      return { last: group.at(-1)?.id ?? 0, page: this.add(page(LEAF_TABLE.kind, group.map(({ bytes }) => bytes), 0)) };
    });
    while (level.length > 1) {
      level = chunks(level, 30).map((group) => {
        const right = group.at(-1);
        const inside = group.slice(0, -1).map(({ last, page: child }) => joined([uint32(child), varint(last)]));
        return { last: right?.last ?? 0, page: this.add(page(5, inside, right?.page ?? 0)) };
      });
    }
    return level[0]?.page ?? this.add(page(LEAF_TABLE.kind, [], 0));
  }

  /** An index, whose interior pages have entries of their own. */
  index(entries: readonly (readonly [bigint, number])[]): number {
    const cells = entries.map((values) => this.payload(record(values), LEAF_INDEX.most, []));
    const most = 12;
    if (cells.length <= most) return this.add(page(LEAF_INDEX.kind, cells, 0));
    const build = (inside: readonly Uint8Array[]): number => {
      if (inside.length <= most) return this.add(page(LEAF_INDEX.kind, inside, 0));
      const share = Math.ceil(inside.length / 6);
      const groups = chunks(inside, share + 1);
      const last = groups.pop() ?? [];
      const children = groups.map((group) => joined([uint32(build(group.slice(0, -1))), group.at(-1) ?? new Uint8Array()]));
      return this.add(page(2, children, build(last)));
    };
    return build(cells);
  }

  file(schema: readonly (readonly Cell[])[]): Uint8Array {
    const cells = schema.map((values, at) => this.payload(record(values), LEAF_TABLE.most, [varint(at + 1)]));
    const first = page(LEAF_TABLE.kind, cells, 0, 100);
    const view = new DataView(first.buffer);
    first.set(TEXT.encode("SQLite format 3\0"));
    view.setUint16(16, PAGE);
    this.made[0] = first;
    view.setUint32(28, this.made.length);
    return joined(this.made);
  }

  private add(one: Uint8Array): number {
    return this.made.push(one);
  }

  /** A cell with its payload, of which a long one continues in overflow pages. */
  private payload(bytes: Uint8Array, most: number, behindLength: readonly Uint8Array[]): Uint8Array {
    const head = [varint(bytes.length), ...behindLength];
    if (bytes.length <= most) return joined([...head, bytes]);
    const fitting = LEAST + ((bytes.length - LEAST) % (PAGE - 4));
    const local = fitting <= most ? fitting : LEAST;
    const rest = chunks([...bytes.subarray(local)], PAGE - 4).map((part) => Uint8Array.from(part));
    const first = this.made.length + 1;
    rest.forEach((part, at) => {
      const next = at + 1 < rest.length ? first + at + 1 : 0;
      this.add(joined([uint32(next), part, new Uint8Array(PAGE - 4 - part.length)]));
    });
    return joined([...head, bytes.subarray(0, local), uint32(first)]);
  }
}

function page(kind: number, cells: readonly Uint8Array[], right: number, start = 0): Uint8Array {
  const bytes = new Uint8Array(PAGE);
  const view = new DataView(bytes.buffer);
  const headLength = kind === 2 || kind === 5 ? 12 : 8;
  view.setUint8(start, kind);
  view.setUint16(start + 3, cells.length);
  if (headLength === 12) view.setUint32(start + 8, right);
  let end = PAGE;
  cells.forEach((cell, at) => {
    end -= cell.length;
    bytes.set(cell, end);
    view.setUint16(start + headLength + 2 * at, end);
  });
  if (end < start + headLength + 2 * cells.length) throw new RangeError("the cells do not fit into their page");
  return bytes;
}

function record(values: readonly Cell[]): Uint8Array {
  const parts = values.map(encoded);
  const serials = joined(parts.map(([serial]) => varint(serial)));
  return joined([varint(serials.length + 1), serials, ...parts.map(([, bytes]) => bytes)]);
}

function encoded(value: Cell): [number, Uint8Array] {
  if (value === null) return [0, new Uint8Array()];
  if (typeof value === "string") return [13 + 2 * TEXT.encode(value).length, TEXT.encode(value)];
  if (value instanceof Uint8Array) return [12 + 2 * value.length, value];
  const bytes = new Uint8Array(8);
  new DataView(bytes.buffer).setBigInt64(0, BigInt(value));
  return [6, bytes];
}

/** Big-endian, seven bits each; numbers below 2^28. */
function varint(value: number): Uint8Array {
  const groups = [value & 127];
  for (let rest = value >> 7; rest > 0; rest >>= 7) groups.unshift((rest & 127) | 128);
  return Uint8Array.from(groups);
}

function uint32(value: number): Uint8Array {
  const bytes = new Uint8Array(4);
  new DataView(bytes.buffer).setUint32(0, value);
  return bytes;
}

function chunks<Item>(items: readonly Item[], size: number): Item[][] {
  return Array.from({ length: Math.ceil(items.length / size) }, (_, at) => items.slice(at * size, (at + 1) * size));
}

/** Groups of items that fit into a leaf page. */
function grouped<Item>(items: readonly Item[], length: (item: Item) => number): Item[][] {
  const groups: Item[][] = [];
  let used = PAGE;
  for (const item of items) {
    const needed = length(item) + 2;
    if (used + needed > PAGE) {
      groups.push([]);
      used = 8;
    }
    groups.at(-1)?.push(item);
    used += needed;
  }
  return groups;
}
