/** ROS 1 bags: reads the index at the end, then only chunks that contain the topic. */

import { unpack } from "../compression/unpack";
import { ReadFailure, type FailureCode } from "../failures";
import { READ_AHEAD } from "../limits";
import type { Source } from "../ranges";
import { fieldsOf, headAt, MAGIC, Op, recordAt, text, timeAt, uint32, uint64 } from "./bag_records";
import type { ChunkCache } from "./chunk_cache";
import {
  inOrder,
  type Channel,
  type ChunkContent,
  type Message,
  type OnDamage,
  type Order,
  type OtherRecord,
  type Piece,
  type Properties,
  type RecordedTopic,
  type Recording,
  type Span,
} from "./recording";

const HEADER = 4096 + MAGIC.length;
const DAMAGED: ReadonlySet<FailureCode> = new Set<FailureCode>(["chunk_damaged", "index_damaged", "too_large"]);

interface Chunk extends Span {
  at: number;
  /** Where the next chunk, or the index of the file, begins. */
  end: number;
  counts: ReadonlyMap<number, number>;
}

/** Open a bag: reads its header and the index at its end; where there is none, up to `maxBytes` to make one.
 *
 * @throws ReadFailure no_index where nothing is there that an index could be made of; index_damaged.
 */
export async function openBag(source: Source, maxBytes: number, cache: ChunkCache): Promise<Recording> {
  const front = await source.read(0, Math.min(HEADER, source.sizeBytes));
  if (text(front.subarray(0, MAGIC.length)) !== MAGIC) throw new ReadFailure("not_readable_here");
  const header = headAt(front, MAGIC.length);
  const indexAt = uint64(header.fields.get("index_pos"));
  if (header.op !== Op.header) throw new ReadFailure("index_damaged", "it begins with no header");
  if (indexAt === 0 || indexAt >= source.sizeBytes) return scan(source, header.dataAt + header.length, maxBytes, cache);
  const index = await source.read(indexAt, source.sizeBytes - indexAt);
  const connections = new Map<number, Channel>();
  const chunks: Chunk[] = [];
  for (let at = 0; at < index.length; ) {
    const record = recordAt(index, at);
    if (record.op === Op.connection) connections.set(uint32(record.fields.get("conn")), connection(record));
    else if (record.op === Op.chunkInfo) chunks.push(chunkInfo(record));
    else throw new ReadFailure("index_damaged", `a record of kind ${record.op}`);
    at = record.next;
  }
  return new BagRecording(source, connections, placed(chunks, indexAt), null, cache);
}

/** Walk the chunks from `start`, each with the index behind it, as far as `maxBytes` reach or they are whole. */
async function scan(source: Source, start: number, maxBytes: number, cache: ChunkCache): Promise<Recording> {
  const connections = new Map<number, Channel>();
  const chunks: Chunk[] = [];
  let at = start;
  source.ahead = READ_AHEAD;
  try {
    while (at < maxBytes || chunks.length === 0) {
      const chunk = await wholeChunk(source, at, connections);
      if (chunk === null) break;
      if (chunk.counts.size > 0) chunks.push(chunk);
      at = chunk.end;
    }
  } catch (thrown) {
    // From here on it is damaged, or something else is wrong.
    if (!(thrown instanceof ReadFailure) || !DAMAGED.has(thrown.code)) throw thrown;
  } finally {
    source.ahead = 0;
  }
  if (chunks.length === 0) throw new ReadFailure("no_index");
  return new BagRecording(source, connections, chunks.sort(byStart), at, cache);
}

/** Return the index entry of the chunk at `at`, and note its connections; null if it is incomplete. */
async function wholeChunk(source: Source, at: number, connections: Map<number, Channel>): Promise<Chunk | null> {
  const [op, end] = await extent(source, at);
  if (op !== Op.chunk || end === null) return null;
  const chunk: Chunk & { counts: Map<number, number> } = { at, end, fromNs: 0n, toNs: 0n, counts: new Map() };
  const inside = recordAt(await source.read(at, end - at), 0);
  const unpacked = unpack(text(inside.fields.get("compression")), inside.data, uint32(inside.fields.get("size")));
  for (let place = 0; place < unpacked.length; ) {
    const record = recordAt(unpacked, place);
    if (record.op === Op.connection) connections.set(uint32(record.fields.get("conn")), connection(record));
    if (record.op === Op.message) noteMessage(chunk, record.fields);
    place = record.next;
  }
  for (;;) {
    const [behind, next] = await extent(source, chunk.end);
    if (behind !== Op.index || next === null) return chunk;
    chunk.end = next;
  }
}

function noteMessage(chunk: Chunk & { counts: Map<number, number> }, fields: ReadonlyMap<string, Uint8Array>): void {
  const id = uint32(fields.get("conn"));
  const time = timeAt(fields.get("time"));
  if (chunk.counts.size === 0 || time < chunk.fromNs) chunk.fromNs = time;
  if (chunk.counts.size === 0 || time > chunk.toNs) chunk.toNs = time;
  chunk.counts.set(id, (chunk.counts.get(id) ?? 0) + 1);
}

/** What kind of record is at `at`, and where it ends; null where that is behind the end of the file. */
async function extent(source: Source, at: number): Promise<[number, number | null]> {
  const head = await source.read(at, Math.min(4096, source.sizeBytes - at));
  if (head.length === 0) return [-1, null];
  const { op, dataAt, length } = headAt(head, 0);
  const end = at + dataAt + length;
  return [op, end <= source.sizeBytes ? end : null];
}

const PROPERTIES = ["callerid", "latching", "md5sum"] as const;
/** The md5sum of a type without fields: its empty definition is no missing one. */
const MD5_OF_NOTHING = "d41d8cd98f00b204e9800998ecf8427e";

function connection(record: { fields: ReadonlyMap<string, Uint8Array>; data: Uint8Array }): Channel {
  const about = fieldsOf(record.data);
  const known = about.get("message_definition")?.slice() ?? new Uint8Array();
  const isEmpty = text(known).trim() === "" && text(about.get("md5sum")) === MD5_OF_NOTHING;
  const definition = isEmpty ? new TextEncoder().encode("# no fields\n") : known;
  const schema = { name: text(about.get("type")), encoding: "ros1msg", messageEncoding: "ros1", definition };
  const properties: Properties = PROPERTIES.map((name) => [name, text(about.get(name))] as const).filter(([, value]) => value !== "");
  const topic = text(record.fields.get("topic"));
  return { topic: topic === "" ? text(about.get("topic")) : topic, schema, properties };
}

function chunkInfo(record: { fields: ReadonlyMap<string, Uint8Array>; data: Uint8Array }): Chunk {
  const counts = new Map<number, number>();
  for (let at = 0; at + 8 <= record.data.length; at += 8) counts.set(uint32(record.data, at), uint32(record.data, at + 4));
  const { fields } = record;
  const [fromNs, toNs] = [timeAt(fields.get("start_time")), timeAt(fields.get("end_time"))];
  return { at: uint64(fields.get("chunk_pos")), end: 0, fromNs, toNs, counts };
}

/** Give each chunk its end, and put them in order of time. */
function placed(chunks: Chunk[], indexAt: number): Chunk[] {
  chunks.sort((a, b) => a.at - b.at);
  chunks.forEach((chunk, number) => {
    chunk.end = chunks[number + 1]?.at ?? indexAt;
    if (chunk.end <= chunk.at || chunk.end > indexAt) throw new ReadFailure("index_damaged", `a chunk at ${chunk.at}`);
  });
  return chunks.sort(byStart);
}

function byStart(a: Chunk, b: Chunk): number {
  return a.fromNs < b.fromNs ? -1 : a.fromNs > b.fromNs ? 1 : a.at - b.at;
}

class BagRecording implements Recording {
  readonly span: Span | null;
  readonly topics: readonly RecordedTopic[];
  readonly channels: readonly Channel[];
  readonly profile = "";
  readonly isIndexContradictory: boolean;

  constructor(
    readonly source: Source,
    private readonly connections: ReadonlyMap<number, Channel>,
    private readonly chunks: readonly Chunk[],
    readonly indexedUntil: number | null,
    private readonly cache: ChunkCache,
  ) {
    const [first] = chunks;
    const latest = chunks.reduce((most, chunk) => (chunk.toNs > most ? chunk.toNs : most), 0n);
    this.span = first === undefined ? null : { fromNs: first.fromNs, toNs: latest };
    this.isIndexContradictory = chunks.some(({ fromNs, toNs }) => fromNs > toNs);
    this.channels = [...connections.values()];
    const named = this.channels.map(({ topic, schema }) => [topic, { name: topic, schema }] as const);
    this.topics = [...new Map(named).values()];
  }

  pieces(topics: readonly string[], span: Span): Piece[] {
    const ids = this.ids(topics);
    return this.holding(ids, span).map(({ fromNs, toNs, at, end, counts }) => {
      const inside = [...counts.keys()].flatMap((id) => this.connections.get(id)?.topic ?? []);
      return { at, fromNs, toNs, bytes: end - at, topics: new Set(inside) };
    });
  }

  async readPiece(piece: Piece, topics: readonly string[]): Promise<readonly Message[]> {
    const chunk = this.chunks.find(({ at }) => at === piece.at);
    if (chunk === undefined) throw new ReadFailure("index_damaged", `no chunk at ${piece.at}`);
    return (await this.read(chunk, this.ids(topics))).messages;
  }

  messages(topics: readonly string[], span: Span, order: Order, onDamage: OnDamage): AsyncIterable<Message> {
    const ids = this.ids(topics);
    return inOrder(this.holding(ids, span), (chunk) => this.read(chunk, ids), { span, order, onDamage });
  }

  /** A bag has none. */
  otherRecords(): AsyncIterable<OtherRecord> {
    return { [Symbol.asyncIterator]: () => ({ next: () => Promise.resolve({ done: true, value: undefined }) }) };
  }

  private ids(topics: readonly string[]): Set<number> {
    return new Set([...this.connections].filter(([, { topic }]) => topics.includes(topic)).map(([id]) => id));
  }

  private holding(ids: ReadonlySet<number>, span: Span): Chunk[] {
    return this.chunks.filter(
      (chunk) =>
        chunk.fromNs <= span.toNs && chunk.toNs >= span.fromNs && [...chunk.counts.keys()].some((id) => ids.has(id)),
    );
  }

  private async read(chunk: Chunk, ids: ReadonlySet<number>): Promise<ChunkContent> {
    const unpacked = await this.cache.get(chunk.at, () => this.load(chunk));
    const messages: Message[] = [];
    for (let at = 0; at < unpacked.length; ) {
      const inside = recordAt(unpacked, at);
      at = inside.next;
      if (inside.op !== Op.message) continue;
      const id = uint32(inside.fields.get("conn"));
      const channel = this.connections.get(id);
      if (channel === undefined || !ids.has(id)) continue;
      const logTimeNs = timeAt(inside.fields.get("time"));
      messages.push({ logTimeNs, publishTimeNs: logTimeNs, sequence: 0, channel, data: inside.data, chunkSpan: chunk });
    }
    return { messages, retainedBytes: unpacked.length };
  }

  /** Read a chunk and decompress it. */
  private async load({ at, end }: Chunk): Promise<Uint8Array> {
    const record = recordAt(await this.source.read(at, end - at), 0);
    if (record.op !== Op.chunk) throw new ReadFailure("chunk_damaged", `no chunk at ${at}`);
    return unpack(text(record.fields.get("compression")), record.data, uint32(record.fields.get("size")));
  }
}
