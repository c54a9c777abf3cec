/** Writes MCAP, chunked and indexed, with every CRC: the same bytes as `McapWriter` in recordings/writing/mcap_writer.py.
 *
 * Memory: one chunk, and the records of the summary. Source: mcap.dev/spec.
 */

import { crc32, crc32Final, crc32Init, crc32Update } from "@foxglove/crc";
import { ReadFailure } from "../failures";
import { joined, type Properties } from "../formats/recording";

/** How chunks are compressed: the name in the file, and what does it. */
export interface Compression {
  readonly name: string;
  readonly compress: (raw: Uint8Array) => Uint8Array;
}

export interface SchemaRecord {
  name: string;
  encoding: string;
  data: Uint8Array;
}

export interface MessageRecord {
  channelId: number;
  sequence: number;
  logTimeNs: bigint;
  publishTimeNs: bigint;
  data: Uint8Array;
}

const OP = {
  header: 1, footer: 2, schema: 3, channel: 4, message: 5, chunk: 6, messageIndex: 7, chunkIndex: 8, attachment: 9,
  attachmentIndex: 10, statistics: 11, metadata: 12, metadataIndex: 13, dataEnd: 15,
} as const;
export const MAGIC = Uint8Array.of(0x89, 0x4d, 0x43, 0x41, 0x50, 0x30, 0x0d, 0x0a);
const CHUNK_BYTES = 2 ** 20;
const MAX_CHANNELS = 2 ** 16;
const MESSAGE_FIXED = 22;
const LATEST = 2n ** 64n - 1n;
const TEXT = new TextEncoder();

/** Fields of a record, in order; integers are little endian. */
export class Bytes {
  private buffer = new Uint8Array(64);
  private length = 0;

  u8(value: number): this {
    return this.put(1, (view, at) => view.setUint8(at, value));
  }

  u16(value: number): this {
    return this.put(2, (view, at) => view.setUint16(at, value, true));
  }

  u32(value: number): this {
    return this.put(4, (view, at) => view.setUint32(at, value, true));
  }

  u64(value: number | bigint): this {
    return this.put(8, (view, at) => view.setBigUint64(at, BigInt(value), true));
  }

  raw(bytes: Uint8Array): this {
    return this.put(bytes.length, (_, at) => this.buffer.set(bytes, at));
  }

  counted(bytes: Uint8Array): this {
    return this.u32(bytes.length).raw(bytes);
  }

  text(text: string): this {
    return this.counted(TEXT.encode(text));
  }

  entries(entries: Properties): this {
    const inside = new Bytes();
    for (const [name, value] of entries) inside.text(name).text(value);
    return this.counted(inside.done());
  }

  done(): Uint8Array {
    return this.buffer.slice(0, this.length);
  }

  private put(size: number, write: (view: DataView, at: number) => void): this {
    const at = this.length;
    this.length += size;
    if (this.length > this.buffer.length) {
      const larger = new Uint8Array(Math.max(2 * this.buffer.length, this.length));
      larger.set(this.buffer.subarray(0, at));
      this.buffer = larger;
    }
    write(new DataView(this.buffer.buffer), at);
    return this;
  }
}

function record(op: number, body: Uint8Array): Uint8Array {
  return new Bytes().u8(op).u64(body.length).raw(body).done();
}

interface Chunk {
  pieces: Uint8Array[];
  size: number;
  firstNs: bigint;
  lastNs: bigint;
  /** Log time and offset of each message, by channel. */
  index: Map<number, bigint[]>;
}

const emptyChunk = (): Chunk => ({ pieces: [], size: 0, firstNs: LATEST, lastNs: 0n, index: new Map() });

export class McapWriter {
  private position = 0;
  private crc = crc32Init();
  private chunk = emptyChunk();
  private readonly counts: number[] = [];
  private readonly schemas: SchemaRecord[] = [];
  private readonly definitions: Uint8Array[] = [];
  private readonly chunkIndexes: Uint8Array[] = [];
  private readonly attachmentIndexes: Uint8Array[] = [];
  private readonly metadataIndexes: Uint8Array[] = [];
  private span = { firstNs: LATEST, lastNs: 0n };

  constructor(
    private readonly write: (bytes: Uint8Array) => void,
    { profile, library }: { profile: string; library: string },
    private readonly compression: Compression,
  ) {
    this.put(MAGIC);
    this.put(record(OP.header, new Bytes().text(profile).text(library).done()));
  }

  /** Bytes written so far. */
  get bytesWritten(): number {
    return this.position;
  }

  /** Define a message type, once; returns its id. */
  addSchema(schema: SchemaRecord): number {
    const known = this.schemas.findIndex((other) => sameSchema(other, schema));
    if (known >= 0) return known + 1;
    const id = this.schemas.push(schema);
    this.define(record(OP.schema, new Bytes().u16(id).text(schema.name).text(schema.encoding).counted(schema.data).done()));
    return id;
  }

  /** Define a topic; returns its id. */
  addChannel(topic: string, schemaId: number, messageEncoding: string, properties: Properties): number {
    const id = this.counts.length;
    if (id >= MAX_CHANNELS) throw new ReadFailure("too_large", topic);
    const body = new Bytes().u16(id).u16(schemaId).text(topic).text(messageEncoding).entries(properties);
    this.define(record(OP.channel, body.done()));
    this.counts.push(0);
    return id;
  }

  addMessage({ channelId, sequence, logTimeNs, publishTimeNs, data }: MessageRecord): void {
    const { chunk } = this;
    this.counts[channelId] = (this.counts[channelId] ?? 0) + 1;
    const index = chunk.index.get(channelId) ?? [];
    chunk.index.set(channelId, index);
    index.push(logTimeNs, BigInt(chunk.size));
    const head = new Bytes().u8(OP.message).u64(MESSAGE_FIXED + data.length);
    this.append(head.u16(channelId).u32(sequence).u64(logTimeNs).u64(publishTimeNs).done());
    this.append(data);
    if (logTimeNs < chunk.firstNs) chunk.firstNs = logTimeNs;
    if (logTimeNs > chunk.lastNs) chunk.lastNs = logTimeNs;
    if (chunk.size >= CHUNK_BYTES) this.flush();
  }

  addMetadata(name: string, entries: Properties): void {
    const metadata = record(OP.metadata, new Bytes().text(name).entries(entries).done());
    this.flush();
    this.metadataIndexes.push(this.indexOf(OP.metadataIndex, metadata.length, new Bytes().text(name).done()));
    this.put(metadata);
  }

  /** Begin to copy an attachment or metadata record of another file: all of its bytes must follow by `copy`. */
  beginCopy(op: number, length: number, indexFields: Uint8Array): void {
    this.flush();
    if (op === OP.attachment) this.attachmentIndexes.push(this.indexOf(OP.attachmentIndex, length, indexFields));
    else this.metadataIndexes.push(this.indexOf(OP.metadataIndex, length, indexFields));
  }

  copy(bytes: Uint8Array): void {
    this.put(bytes);
  }

  /** Write what is left, the summary and the footer. */
  finish(): void {
    this.flush();
    this.put(record(OP.dataEnd, new Bytes().u32(crc32Final(this.crc)).done()));
    const summaryStart = this.position;
    this.crc = crc32Init();
    const records = [...this.definitions, this.statistics(), ...this.chunkIndexes, ...this.attachmentIndexes, ...this.metadataIndexes];
    for (const one of records) this.put(one);
    const footer = new Bytes().u8(OP.footer).u64(20).u64(summaryStart).u64(0).done();
    const crc = crc32Final(crc32Update(this.crc, footer));
    this.put(joined([footer, new Bytes().u32(crc).done(), MAGIC]));
  }

  private statistics(): Uint8Array {
    const total = this.counts.reduce((sum, count) => sum + count, 0);
    const counts = new Bytes();
    this.counts.forEach((count, id) => counts.u16(id).u64(count));
    const body = new Bytes().u64(total).u16(this.schemas.length).u32(this.counts.length);
    body.u32(this.attachmentIndexes.length).u32(this.metadataIndexes.length).u32(this.chunkIndexes.length);
    body.u64(total > 0 ? this.span.firstNs : 0).u64(total > 0 ? this.span.lastNs : 0).counted(counts.done());
    return record(OP.statistics, body.done());
  }

  private indexOf(op: number, length: number, fields: Uint8Array): Uint8Array {
    return record(op, new Bytes().u64(this.position).u64(length).raw(fields).done());
  }

  private define(definition: Uint8Array): void {
    this.definitions.push(definition);
    this.append(definition);
  }

  private append(piece: Uint8Array): void {
    this.chunk.pieces.push(piece);
    this.chunk.size += piece.length;
  }

  private flush(): void {
    const { chunk } = this;
    if (chunk.size === 0) return;
    if (chunk.index.size === 0) chunk.firstNs = 0n;
    else {
      if (chunk.firstNs < this.span.firstNs) this.span.firstNs = chunk.firstNs;
      if (chunk.lastNs > this.span.lastNs) this.span.lastNs = chunk.lastNs;
    }
    const raw = joined(chunk.pieces);
    const stored = this.compression.compress(raw);
    const start = this.position;
    const head = new Bytes().u64(chunk.firstNs).u64(chunk.lastNs).u64(raw.length).u32(crc32(raw)).text(this.compression.name).u64(stored.length).done();
    this.put(new Bytes().u8(OP.chunk).u64(head.length + stored.length).raw(head).done());
    this.put(stored);
    const indexStart = this.position;
    const offsets = this.putMessageIndexes(chunk);
    const body = new Bytes().u64(chunk.firstNs).u64(chunk.lastNs).u64(start).u64(indexStart - start).counted(offsets);
    body.u64(this.position - indexStart).text(this.compression.name).u64(stored.length).u64(raw.length);
    this.chunkIndexes.push(record(OP.chunkIndex, body.done()));
    this.chunk = emptyChunk();
  }

  /** Returns the offsets of the indexes, for the index of the chunk. */
  private putMessageIndexes({ index }: Chunk): Uint8Array {
    const offsets = new Bytes();
    for (const [channelId, entries] of index) {
      offsets.u16(channelId).u64(this.position);
      const packed = new Uint8Array(BigUint64Array.from(entries).buffer);
      this.put(record(OP.messageIndex, new Bytes().u16(channelId).counted(packed).done()));
    }
    return offsets.done();
  }

  private put(bytes: Uint8Array): void {
    this.write(bytes);
    this.position += bytes.length;
    this.crc = crc32Update(this.crc, bytes);
  }
}

export function sameSchema(one: SchemaRecord, other: SchemaRecord): boolean {
  return one.name === other.name && one.encoding === other.encoding && sameBytes(one.data, other.data);
}

function sameBytes(one: Uint8Array, other: Uint8Array): boolean {
  return one === other || (one.length === other.length && one.every((byte, at) => byte === other[at]));
}
