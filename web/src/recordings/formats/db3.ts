/** rosbag2 databases: finds messages by the index of times, and reads only the pages of those that are needed.
 *
 * Source: rosbag2_storage_sqlite3: topics(id, name, type, serialization_format, offered_qos_profiles),
 * messages(id, topic_id, timestamp, data) with an index of timestamps, message_definitions (from Iron on).
 */

import { ReadFailure } from "../failures";
import { MAX_DEFINITION, MAX_OVERLAPPING, READ_AHEAD } from "../limits";
import type { Source } from "../ranges";
import { SqliteFile, type Row, type SqlValue, type Tree } from "./sqlite";
import {
  type Channel,
  type Message,
  type OnDamage,
  type Order,
  type OtherRecord,
  type Piece,
  type RecordedTopic,
  type Recording,
  type Schema,
  type Span,
} from "./recording";

/** The parts into which a recording is divided at least, if it is large: few, since each page of an index is a request. */
const ENOUGH_PIECES = 16;
const MAX_TOPICS = 100_000;
const LATEST_NS = (1n << 63n) - 1n;

/** A message by its time and its row. */
interface Placed {
  logTimeNs: bigint;
  rowId: number;
}

interface Times {
  span: Span | null;
  /** Times that divide the messages into parts of about equal size. */
  dividers: readonly bigint[];
  indexedUntil: number | null;
  within: (span: Span, order: Order) => AsyncIterable<Placed>;
}

/** Open a database by its index of times; without one, by the rows in up to `maxBytes`.
 *
 * @throws ReadFailure not_readable_here, where it is no recording; index_damaged.
 */
export async function openDb3(source: Source, maxBytes: number): Promise<Recording> {
  const file = await SqliteFile.open(source);
  const trees = await file.trees();
  const [topics, messages] = ["topics", "messages"].map((name) => trees.find((tree) => tree.kind === "table" && tree.name === name));
  if (topics === undefined || messages === undefined) throw new ReadFailure("not_readable_here");
  const definitions = await readDefinitions(file, trees);
  const channels = await readChannels(file, topics, definitions);
  const columns = columnsOf(messages.sql);
  const places = { topicId: columns.indexOf("topic_id"), timestamp: columns.indexOf("timestamp"), data: columns.indexOf("data") };
  if (Object.values(places).includes(-1)) throw new ReadFailure("not_readable_here");
  const index = trees.find(({ kind, table, sql }) => kind === "index" && table === "messages" && /\(\s*["'`[]?timestamp\b/i.test(sql));
  const times = (await indexedTimes(file, index)) ?? (await scanTimes(file, messages.rootPage, places.timestamp, source, maxBytes));
  return new Db3Recording(source, file, messages.rootPage, places, channels, times);
}

/** The columns of a table, by the statement that made it. */
function columnsOf(sql: string): string[] {
  const inside = sql.slice(sql.indexOf("(") + 1);
  return inside.split(",").map((part) => (/^\s*["'`[]?(\w+)/.exec(part)?.[1] ?? "").toLowerCase());
}

async function readDefinitions(file: SqliteFile, trees: readonly Tree[]): Promise<ReadonlyMap<string, readonly [string, string]>> {
  const definitions = new Map<string, readonly [string, string]>();
  const table = trees.find(({ kind, name }) => kind === "table" && name === "message_definitions");
  if (table === undefined) return definitions;
  const places = ["topic_type", "encoding", "encoded_message_definition"].map((name) => columnsOf(table.sql).indexOf(name));
  let size = 0;
  for await (const row of file.rows(table.rootPage)) {
    const [name, encoding, text] = await texts(file, row, places);
    size += text?.length ?? 0;
    if (size > MAX_DEFINITION) break;
    if (name !== undefined && encoding !== undefined && text !== undefined && !definitions.has(name)) definitions.set(name, [encoding, text]);
  }
  return definitions;
}

async function readChannels(file: SqliteFile, table: Tree, definitions: ReadonlyMap<string, readonly [string, string]>): Promise<ReadonlyMap<number, Channel>> {
  const names = ["name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"];
  const places = names.map((name) => columnsOf(table.sql).indexOf(name));
  const channels = new Map<number, Channel>();
  const schemas = new Map<string, Schema>();
  for await (const row of file.rows(table.rootPage)) {
    const [name = "", type = "", format = "", profiles = "", hash = ""] = await texts(file, row, places);
    const [encoding, text] = definitions.get(type) ?? ["", ""];
    const messageEncoding = format === "" ? "cdr" : format;
    const key = `${type} ${messageEncoding}`;
    const schema = schemas.get(key) ?? { name: type, encoding, messageEncoding, definition: new TextEncoder().encode(text) };
    schemas.set(key, schema);
    const properties = [["offered_qos_profiles", profiles] as const, ["topic_type_hash", hash] as const].filter(([, value]) => value !== "");
    channels.set(row.id, { topic: name, schema, properties });
    if (channels.size > MAX_TOPICS) throw new ReadFailure("too_large", `${channels.size} topics`);
  }
  return channels;
}

async function texts(file: SqliteFile, row: Row, places: readonly number[]): Promise<(string | undefined)[]> {
  return (await file.values(row, places)).map((value) => (typeof value === "string" ? value : undefined));
}

/** Returns the times of an index; null where there is none that can be read. */
async function indexedTimes(file: SqliteFile, index: Tree | undefined): Promise<Times | null> {
  if (index === undefined) return null;
  try {
    return await readIndex(file, index.rootPage);
  } catch (thrown) {
    if (!isDamage(thrown)) throw thrown;
    return null;
  }
}

async function readIndex(file: SqliteFile, rootPage: number): Promise<Times> {
  async function* within({ fromNs, toNs }: Span, order: Order): AsyncIterable<Placed> {
    for await (const entry of file.entries(rootPage, fromNs, toNs, order)) {
      const placed = placedOf(entry[0], entry.at(-1));
      if (placed !== null) yield placed;
    }
  }
  const all = { fromNs: 0n, toNs: LATEST_NS };
  const ends: bigint[] = [];
  for (const order of ["forward", "backward"] as const) {
    for await (const { logTimeNs } of within(all, order)) {
      ends.push(logTimeNs);
      break;
    }
  }
  const [fromNs, toNs] = ends;
  const span = fromNs === undefined || toNs === undefined ? null : { fromNs, toNs };
  return { span, dividers: await file.dividers(rootPage, ENOUGH_PIECES), indexedUntil: null, within };
}

/** Reads the times of all rows, as far as `maxBytes` reach. */
async function scanTimes(file: SqliteFile, rootPage: number, place: number, source: Source, maxBytes: number): Promise<Times> {
  const placed: Placed[] = [];
  const mostRows = Math.ceil(Math.min(maxBytes, source.sizeBytes) / 8);
  source.ahead = READ_AHEAD;
  try {
    for await (const row of file.rows(rootPage)) {
      const one = placedOf(await file.value(row, place), row.id);
      if (one !== null) placed.push(one);
      if (placed.length >= mostRows || file.pagesRead * file.pageBytes > maxBytes) break;
    }
  } catch (thrown) {
    // What comes behind a damaged page is not seen.
    if (!isDamage(thrown) || placed.length === 0) throw thrown;
  } finally {
    source.ahead = 0;
  }
  const sorted = placed.sort((a, b) => (a.logTimeNs < b.logTimeNs ? -1 : a.logTimeNs > b.logTimeNs ? 1 : a.rowId - b.rowId));
  const [first] = sorted;
  const last = sorted.at(-1);
  const span = first === undefined || last === undefined ? null : { fromNs: first.logTimeNs, toNs: last.logTimeNs };
  const share = Math.ceil(sorted.length / ENOUGH_PIECES);
  const dividers = sorted.filter((_, number) => number > 0 && number % share === 0).map(({ logTimeNs }) => logTimeNs);
  async function* within({ fromNs, toNs }: Span, order: Order): AsyncIterable<Placed> {
    await Promise.resolve();
    const inside = sorted.filter(({ logTimeNs }) => logTimeNs >= fromNs && logTimeNs <= toNs);
    yield* order === "forward" ? inside : inside.reverse();
  }
  return { span, dividers, indexedUntil: Math.min(maxBytes, source.sizeBytes), within };
}

function placedOf(time: SqlValue | undefined, rowId: SqlValue | undefined): Placed | null {
  if ((typeof time !== "bigint" && typeof time !== "number") || (typeof rowId !== "bigint" && typeof rowId !== "number")) return null;
  return time >= 0 && Number.isInteger(Number(time)) ? { logTimeNs: BigInt(time), rowId: Number(rowId) } : null;
}

/** Where the columns of a message are in its row. */
interface Places {
  topicId: number;
  data: number;
}

class Db3Recording implements Recording {
  readonly span: Span | null;
  readonly indexedUntil: number | null;
  readonly topics: readonly RecordedTopic[];
  readonly channels: readonly Channel[];
  readonly profile = "ros2";
  readonly isIndexContradictory = false;
  private readonly parts: readonly Piece[];

  constructor(
    readonly source: Source,
    private readonly file: SqliteFile,
    private readonly rootPage: number,
    private readonly places: Places,
    private readonly channelsById: ReadonlyMap<number, Channel>,
    private readonly times: Times,
  ) {
    this.span = times.span;
    this.indexedUntil = times.indexedUntil;
    this.channels = [...channelsById.values()];
    this.topics = [...new Map(this.channels.map(({ topic, schema }) => [topic, { name: topic, schema }] as const)).values()];
    this.parts = partsOf(times, source.sizeBytes);
  }

  pieces(_topics: readonly string[], span: Span): Piece[] {
    return this.parts.filter(({ fromNs, toNs }) => fromNs <= span.toNs && toNs >= span.fromNs);
  }

  async readPiece(piece: Piece, topics: readonly string[]): Promise<readonly Message[]> {
    const messages: Message[] = [];
    let bytes = 0;
    const refuse: OnDamage = ({ failure }) => {
      throw failure;
    };
    for await (const message of this.messages(topics, piece, "forward", refuse)) {
      messages.push(message);
      bytes += message.data.length;
      if (bytes > MAX_OVERLAPPING) throw new ReadFailure("too_large");
    }
    return messages;
  }

  async *messages(topics: readonly string[], span: Span, order: Order, onDamage: OnDamage): AsyncIterable<Message> {
    const ids = new Set([...this.channelsById].filter(([, { topic }]) => topics.includes(topic)).map(([id]) => id));
    if (ids.size === 0) return;
    let reached = order === "forward" ? span.fromNs : span.toNs;
    try {
      for await (const placed of this.times.within(span, order)) {
        reached = placed.logTimeNs;
        const message = await this.message(placed, ids, onDamage);
        if (message !== null) yield message;
      }
    } catch (thrown) {
      // A damaged page of the index hides all that is behind it.
      if (!isDamage(thrown)) throw thrown;
      onDamage(order === "forward" ? { fromNs: reached, toNs: span.toNs, failure: thrown } : { fromNs: span.fromNs, toNs: reached, failure: thrown });
    }
  }

  /** A database has none. */
  otherRecords(): AsyncIterable<OtherRecord> {
    return { [Symbol.asyncIterator]: () => ({ next: () => Promise.resolve({ done: true, value: undefined }) }) };
  }

  private async message({ logTimeNs, rowId }: Placed, ids: ReadonlySet<number>, onDamage: OnDamage): Promise<Message | null> {
    try {
      const row = await this.file.row(this.rootPage, rowId);
      if (row === null) return null;
      const id = Number(await this.file.value(row, this.places.topicId));
      const channel = this.channelsById.get(id);
      if (channel === undefined || !ids.has(id)) return null;
      const data = await this.file.value(row, this.places.data);
      if (!(data instanceof Uint8Array)) return null;
      const chunkSpan = { fromNs: logTimeNs, toNs: logTimeNs };
      return { logTimeNs, publishTimeNs: logTimeNs, sequence: 0, channel, data, chunkSpan };
    } catch (thrown) {
      if (!isDamage(thrown)) throw thrown;
      onDamage({ fromNs: logTimeNs, toNs: logTimeNs, failure: thrown });
      return null;
    }
  }
}

function isDamage(thrown: unknown): thrown is ReadFailure {
  return thrown instanceof ReadFailure && thrown.code === "index_damaged";
}

/** Parts of a recording by the dividers of its index, of equal size. */
function partsOf({ span, dividers }: Times, sizeBytes: number): Piece[] {
  if (span === null) return [];
  const inside = [...new Set(dividers)].filter((at) => at > span.fromNs && at <= span.toNs);
  const starts = [span.fromNs, ...inside];
  const bytes = Math.ceil(sizeBytes / starts.length);
  return starts.map((fromNs, number) => ({ fromNs, toNs: (starts[number + 1] ?? span.toNs + 1n) - 1n, at: number * bytes, bytes, topics: null }));
}
