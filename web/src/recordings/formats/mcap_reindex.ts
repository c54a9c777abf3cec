/** A summary for an MCAP file that was not closed: scans its beginning once and appends a summary of it.
 *
 * Source: mcap.dev/spec, "Records". What is there is walked record by record; a cut or damaged end is left out.
 */

import { McapRecordBuilder } from "@mcap/core";
import { unpack } from "@/recordings/compression/unpack";
import { ReadFailure } from "@/recordings/failures";
import { MAX_READ_AT_ONCE } from "@/recordings/limits";
import type { ByteSource } from "@/recordings/ranges";

const MAGIC_LENGTH = 8;
const RECORD_HEAD = 9;
const MAX_RECORDS = 100_000;
export const OP = { footer: 2, schema: 3, channel: 4, message: 5, chunk: 6, messageIndex: 7, attachment: 9, metadata: 12, dataEnd: 15 } as const;
const TEXT = new TextDecoder();

type ChunkIndex = Parameters<McapRecordBuilder["writeChunkIndex"]>[0];

/** The file as far as it was walked, and behind it a summary of that. */
export interface RebuiltMcap extends ByteSource {
  /** Where what was recorded ends, for us. */
  readonly endsAt: number;
}

/** Read up to `maxBytes` of the beginning (at least one record), and put an index behind it.
 *
 * @throws ReadFailure no_index where nothing that could be indexed is there.
 */
export async function rebuildIndex(source: ByteSource, maxBytes: number): Promise<RebuiltMcap> {
  const walk = new Walk(source);
  let at = MAGIC_LENGTH;
  for (let number = 0; number < MAX_RECORDS && (at < maxBytes || walk.chunks.length === 0); number++) {
    const next = await walk.record(at);
    if (next === null) break;
    at = next;
  }
  if (walk.chunks.length === 0) throw new ReadFailure("no_index");
  const tail = walk.summary(at);
  return {
    sizeBytes: at + tail.length,
    endsAt: at,
    read: async (offset, length) => {
      const real = Math.max(0, Math.min(length, at - offset));
      const bytes = new Uint8Array(length);
      if (real > 0) bytes.set(await source.read(offset, real));
      const made = tail.subarray(Math.max(0, offset - at), offset + length - at);
      if (real < length) bytes.set(made, real);
      return bytes;
    },
  };
}

class Walk {
  readonly chunks: ChunkIndex[] = [];
  private readonly schemas = new Map<number, Parameters<McapRecordBuilder["writeSchema"]>[0]>();
  private readonly channels = new Map<number, Parameters<McapRecordBuilder["writeChannel"]>[0]>();

  constructor(private readonly source: ByteSource) {}

  /** Note the record at `at`; return where the next begins, null where there is none that is whole. */
  async record(at: number): Promise<number | null> {
    if (at + RECORD_HEAD > this.source.sizeBytes) return null;
    const head = view(await this.source.read(at, RECORD_HEAD));
    const op = head.getUint8(0);
    const length = Number(head.getBigUint64(1, true));
    const next = at + RECORD_HEAD + length;
    if (!(next <= this.source.sizeBytes) || op === 0) return null;
    if (op !== OP.chunk && op !== OP.schema && op !== OP.channel && op !== OP.messageIndex) return next;
    if (length > MAX_READ_AT_ONCE) return null;
    const body = await this.source.read(at + RECORD_HEAD, length);
    try {
      if (op === OP.chunk) this.chunk(body, at, next - at);
      else if (op === OP.messageIndex) this.messageIndex(body, at, next - at);
      else this.definition(op, new Fields(body));
    } catch (thrown) {
      if (thrown instanceof RangeError || thrown instanceof ReadFailure) return null; // from here on it is damaged
      throw thrown;
    }
    return next;
  }

  summary(at: number): Uint8Array {
    const builder = new McapRecordBuilder();
    builder.writeDataEnd({ dataSectionCrc: 0 });
    const summaryStart = BigInt(at + builder.length);
    for (const schema of this.schemas.values()) builder.writeSchema(schema);
    for (const channel of this.channels.values()) builder.writeChannel(channel);
    for (const chunk of this.chunks) builder.writeChunkIndex(chunk);
    builder.writeFooter({ summaryStart, summaryOffsetStart: 0n, summaryCrc: 0 });
    builder.writeMagic();
    return builder.buffer.slice();
  }

  private chunk(body: Uint8Array, at: number, length: number): void {
    const fields = new Fields(body);
    const [messageStartTime, messageEndTime, uncompressedSize] = [fields.uint64(), fields.uint64(), fields.uint64()];
    fields.skip(4); // a checksum, which reading compares
    const compression = fields.text();
    const records = fields.bytes(Number(fields.uint64()));
    const inside = unpack(compression, records, Number(uncompressedSize));
    for (let place = 0; place < inside.length; ) {
      const head = new Fields(inside.subarray(place));
      const op = head.uint8();
      const size = Number(head.uint64());
      const record = head.bytes(size);
      if (op === OP.schema || op === OP.channel) this.definition(op, new Fields(record));
      place += RECORD_HEAD + size;
    }
    this.chunks.push({
      messageStartTime,
      messageEndTime,
      chunkStartOffset: BigInt(at),
      chunkLength: BigInt(length),
      messageIndexOffsets: new Map(),
      messageIndexLength: 0n,
      compression,
      compressedSize: BigInt(records.length),
      uncompressedSize,
    });
  }

  private messageIndex(body: Uint8Array, at: number, length: number): void {
    const last = this.chunks.at(-1);
    if (last === undefined) return;
    last.messageIndexOffsets.set(new Fields(body).uint16(), BigInt(at));
    last.messageIndexLength += BigInt(length);
  }

  private definition(op: number, fields: Fields): void {
    const id = fields.uint16();
    if (op === OP.schema) {
      const [name, encoding] = [fields.text(), fields.text()];
      this.schemas.set(id, { id, name, encoding, data: fields.bytes(fields.uint32()).slice() });
    } else {
      const schemaId = fields.uint16();
      this.channels.set(id, { id, schemaId, topic: fields.text(), messageEncoding: fields.text(), metadata: new Map() });
    }
  }
}

/** Fields of a record, in order. @throws RangeError where it ends too early. */
export class Fields {
  private readonly view: DataView;
  private at = 0;

  constructor(private readonly record: Uint8Array) {
    this.view = view(record);
  }

  /** Bytes after what was taken so far. */
  get left(): number {
    return this.record.length - this.at;
  }

  uint8(): number {
    return this.view.getUint8(this.skip(1));
  }

  uint16(): number {
    return this.view.getUint16(this.skip(2), true);
  }

  uint32(): number {
    return this.view.getUint32(this.skip(4), true);
  }

  uint64(): bigint {
    return this.view.getBigUint64(this.skip(8), true);
  }

  text(): string {
    return TEXT.decode(this.bytes(this.uint32()));
  }

  bytes(length: number): Uint8Array {
    const start = this.skip(length);
    return this.record.subarray(start, start + length);
  }

  skip(length: number): number {
    const start = this.at;
    if (!(start + length <= this.record.length)) throw new RangeError(`a record ends at byte ${start}`);
    this.at = start + length;
    return start;
  }
}

function view(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}
