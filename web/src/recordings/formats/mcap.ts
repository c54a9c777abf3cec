/** MCAP: reads the summary at the end, then only chunks that contain the topic in the time range. */

import { crc32 } from "@foxglove/crc";
import { McapIndexedReader } from "@mcap/core";
import { unpack } from "../compression/unpack";
import { failureOf, ReadFailure } from "../failures";
import { MAX_OVERLAPPING, MAX_READ_AT_ONCE, READ_AHEAD } from "../limits";
import type { ByteSource, Source } from "../ranges";
import {
  inOrder,
  mostOverlappingBytes,
  type Channel,
  type ChunkContent,
  type Message,
  type OnDamage,
  type Order,
  type OtherRecord,
  type Piece,
  type RecordedTopic,
  type Recording,
  type Span,
} from "./recording";
import type { ChunkCache } from "./chunk_cache";
import { otherRecordsOf } from "./mcap_other_records";
import { Fields, OP, rebuildIndex } from "./mcap_reindex";

const TAIL = 512 * 1024;

/** Open an MCAP: reads its beginning and its summary; where there is none, up to `maxBytes` to make one.
 *
 * @throws ReadFailure no_index where nothing is there that an index could be made of; index_damaged.
 */
export async function openMcap(source: Source, maxBytes: number, cache: ChunkCache): Promise<Recording> {
  const tail = Math.min(TAIL, source.sizeBytes);
  await source.read(source.sizeBytes - tail, tail); // one request for what is mostly the whole summary
  try {
    return new McapRecording(source, await opened(source), null, cache);
  } catch (thrown) {
    if (!(thrown instanceof ReadFailure) || thrown.code !== "no_index") throw thrown;
  }
  source.ahead = READ_AHEAD;
  try {
    const rebuilt = await rebuildIndex(source, maxBytes);
    return new McapRecording(source, await opened(rebuilt), rebuilt.endsAt, cache);
  } finally {
    source.ahead = 0;
  }
}

async function opened(source: ByteSource): Promise<McapIndexedReader> {
  let reader: McapIndexedReader;
  try {
    reader = await McapIndexedReader.Initialize({ readable: readable(source) });
  } catch (thrown) {
    const detail = thrown instanceof Error ? thrown.message : "";
    throw /not indexed|Magic|footer/i.test(detail) ? new ReadFailure("no_index") : failureOf(thrown, "index_damaged");
  }
  const isEmpty = reader.statistics?.messageCount === 0n;
  if (reader.chunkIndexes.length === 0 && !isEmpty) throw new ReadFailure("no_index");
  return reader;
}

function readable(source: ByteSource): { size: () => Promise<bigint>; read: (o: bigint, l: bigint) => Promise<Uint8Array> } {
  return {
    size: () => Promise.resolve(BigInt(source.sizeBytes)),
    read: (offset, length) => source.read(Number(offset), Number(length)),
  };
}

type ChunkIndex = McapIndexedReader["chunkIndexes"][number];

class McapRecording implements Recording {
  readonly span: Span | null;
  readonly topics: readonly RecordedTopic[];
  readonly profile: string;
  readonly isIndexContradictory: boolean;
  private readonly channelsById = new Map<number, Channel>();

  constructor(
    readonly source: Source,
    private readonly reader: McapIndexedReader,
    readonly indexedUntil: number | null,
    private readonly cache: ChunkCache,
  ) {
    this.span = spanOf(reader.chunkIndexes);
    this.profile = reader.header.profile;
    this.isIndexContradictory = contradictsItself(reader, this.span);
    for (const channel of reader.channelsById.values()) {
      const schema = reader.schemasById.get(channel.schemaId);
      this.channelsById.set(channel.id, {
        topic: channel.topic,
        properties: [...channel.metadata],
        schema: {
          name: schema?.name ?? "",
          encoding: schema?.encoding ?? "",
          messageEncoding: channel.messageEncoding,
          definition: schema?.data ?? new Uint8Array(),
        },
      });
    }
    this.topics = [...new Map(this.channels.map(({ topic, schema }) => [topic, { name: topic, schema }])).values()];
  }

  get channels(): readonly Channel[] {
    return [...this.channelsById.values()];
  }

  pieces(topics: readonly string[], span: Span): Piece[] {
    return this.chunks(topics, span).map((chunk) => ({
      at: Number(chunk.chunkStartOffset),
      fromNs: chunk.messageStartTime,
      toNs: chunk.messageEndTime,
      bytes: Number(chunk.chunkLength + chunk.messageIndexLength),
      topics: chunk.messageIndexOffsets.size === 0 ? null : this.topicsOf(chunk),
    }));
  }

  async readPiece(piece: Piece, topics: readonly string[]): Promise<readonly Message[]> {
    const index = this.reader.chunkIndexes.find((chunk) => Number(chunk.chunkStartOffset) === piece.at);
    if (index === undefined) throw new ReadFailure("index_damaged", `no chunk at ${piece.at}`);
    return (await this.read(index, new Set(topics))).messages;
  }

  messages(topics: readonly string[], span: Span, order: Order, onDamage: OnDamage): AsyncIterable<Message> {
    const chunks = this.chunks(topics, span);
    const selected = new Set(topics);
    this.checkSizes(chunks);
    const placed = chunks.map((index) => {
      return { index, at: Number(index.chunkStartOffset), fromNs: index.messageStartTime, toNs: index.messageEndTime };
    });
    return inOrder(placed, ({ index }) => this.read(index, selected), { span, order, onDamage });
  }

  otherRecords(): AsyncIterable<OtherRecord> {
    const chunks = this.reader.chunkIndexes.map((chunk) => {
      const at = Number(chunk.chunkStartOffset);
      return { at, end: at + Number(chunk.chunkLength + chunk.messageIndexLength) };
    });
    return otherRecordsOf(this.source, chunks);
  }

  private async read(index: ChunkIndex, topics: ReadonlySet<string>): Promise<ChunkContent> {
    const content = await this.cache.get(Number(index.chunkStartOffset), () => this.load(index));
    const messages: Message[] = [];
    const chunkSpan = { fromNs: index.messageStartTime, toNs: index.messageEndTime };
    const records = new Fields(content);
    while (records.left > 0) {
      const op = records.uint8();
      const body = records.bytes(Number(records.uint64()));
      if (op !== OP.message) continue;
      const fields = new Fields(body);
      const channel = this.channelsById.get(fields.uint16());
      if (channel === undefined || !topics.has(channel.topic)) continue;
      const [sequence, logTimeNs, publishTimeNs] = [fields.uint32(), fields.uint64(), fields.uint64()];
      messages.push({ logTimeNs, publishTimeNs, sequence, channel, data: fields.bytes(fields.left), chunkSpan });
    }
    return { messages, retainedBytes: content.length };
  }

  /** Read a chunk and decompress it. */
  private async load(index: ChunkIndex): Promise<Uint8Array> {
    const record = new Fields(await this.source.read(Number(index.chunkStartOffset), Number(index.chunkLength)));
    if (record.uint8() !== OP.chunk) throw new ReadFailure("chunk_damaged", `no chunk at ${index.chunkStartOffset}`);
    record.skip(8 + 16); // the length of the record, first and last time
    const [size, crc, compression] = [Number(record.uint64()), record.uint32(), record.text()];
    const content = unpack(compression, record.bytes(Number(record.uint64())), size);
    if (crc !== 0 && crc32(content) !== crc) throw new ReadFailure("chunk_damaged", "its checksum differs");
    return content;
  }

  private topicsOf(chunk: ChunkIndex): ReadonlySet<string> {
    return new Set([...chunk.messageIndexOffsets.keys()].flatMap((id) => this.channelsById.get(id)?.topic ?? []));
  }

  private chunks(topics: readonly string[], span: Span): ChunkIndex[] {
    const ids = [...this.channelsById].filter(([, { topic }]) => topics.includes(topic)).map(([id]) => id);
    return this.reader.chunkIndexes
      .filter((chunk) => chunk.messageStartTime <= span.toNs && chunk.messageEndTime >= span.fromNs)
      .filter((chunk) => chunk.messageIndexOffsets.size === 0 || ids.some((id) => chunk.messageIndexOffsets.has(id)))
      .sort(byStart);
  }

  private checkSizes(chunks: ChunkIndex[]): void {
    const longest = Math.max(0, ...chunks.map((chunk) => Number(chunk.chunkLength)));
    if (longest > MAX_READ_AT_ONCE) throw new ReadFailure("too_large", String(longest));
    const spans = chunks.map((chunk) => ({
      fromNs: chunk.messageStartTime,
      toNs: chunk.messageEndTime,
      bytes: Number(chunk.uncompressedSize),
    }));
    const overlapping = mostOverlappingBytes(spans, (chunk) => chunk.bytes);
    if (overlapping > MAX_OVERLAPPING) throw new ReadFailure("too_large", String(overlapping));
  }
}

function byStart(a: ChunkIndex, b: ChunkIndex): number {
  if (a.messageStartTime === b.messageStartTime) return Number(a.chunkStartOffset - b.chunkStartOffset);
  return a.messageStartTime < b.messageStartTime ? -1 : 1;
}

function contradictsItself({ chunkIndexes, statistics }: McapIndexedReader, span: Span | null): boolean {
  if (chunkIndexes.some((chunk) => chunk.messageStartTime > chunk.messageEndTime)) return true;
  if (statistics === undefined || statistics.messageEndTime === 0n || span === null) return false;
  return statistics.messageStartTime !== span.fromNs || statistics.messageEndTime !== span.toNs;
}

function spanOf(chunks: readonly ChunkIndex[]): Span | null {
  // A chunk without messages has the span 0 to 0.
  const filled = chunks.filter((chunk) => chunk.messageEndTime > 0n);
  const [first] = filled;
  if (first === undefined) return null;
  return filled.reduce<Span>(
    (span, chunk) => ({
      fromNs: chunk.messageStartTime < span.fromNs ? chunk.messageStartTime : span.fromNs,
      toNs: chunk.messageEndTime > span.toNs ? chunk.messageEndTime : span.toNs,
    }),
    { fromNs: first.messageStartTime, toNs: first.messageEndTime },
  );
}
