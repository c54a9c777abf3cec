/** Finds the attachments and metadata records of an MCAP between its chunks, so that they can be copied.
 *
 * Source: mcap.dev/spec, "Records".
 */

import { crc32Final, crc32Init, crc32Update } from "@foxglove/crc";
import { ReadFailure } from "../failures";
import { MAX_READ_AT_ONCE, READ_AHEAD } from "../limits";
import type { ByteSource } from "../ranges";
import { Fields, OP } from "./mcap_reindex";
import type { OtherRecord } from "./recording";

const MAGIC_LENGTH = 8;
const HEAD = 9;
const CRC = 4;

/** `chunks`: where each begins, and where its index ends. Reads only what lies between them. */
export async function* otherRecordsOf(source: ByteSource, chunks: readonly { at: number; end: number }[]): AsyncIterable<OtherRecord> {
  let from = MAGIC_LENGTH;
  for (const { at, end } of [...chunks.toSorted((a, b) => a.at - b.at), { at: source.sizeBytes, end: source.sizeBytes }]) {
    yield* between(source, from, at);
    from = Math.max(from, end);
  }
}

async function* between(source: ByteSource, start: number, end: number): AsyncIterable<OtherRecord> {
  for (let at = start; end - at >= HEAD; ) {
    const head = new Fields(await source.read(at, HEAD));
    const op = head.uint8();
    const length = HEAD + Number(head.uint64());
    if (op === 0 || op === OP.dataEnd || op === OP.footer || at + length > end) return;
    if (op === OP.attachment) yield await attachment(source, at, length);
    if (op === OP.metadata) yield await metadata(source, at, length);
    at += length;
  }
}

async function metadata(source: ByteSource, at: number, length: number): Promise<OtherRecord> {
  if (length > MAX_READ_AT_ONCE) throw new ReadFailure("too_large", String(length));
  const body = await source.read(at + HEAD, length - HEAD);
  return { op: OP.metadata, at, length, indexFields: fieldsUpTo(body, 0, 1) };
}

/** Returns an attachment whose checksum is right. */
async function attachment(source: ByteSource, at: number, length: number): Promise<OtherRecord> {
  const [body, end] = [at + HEAD, at + length - CRC];
  let crc = crc32Init();
  for (let place = body; place < end; place += READ_AHEAD) {
    crc = crc32Update(crc, await source.read(place, Math.min(READ_AHEAD, end - place)));
  }
  const claimed = new Fields(await source.read(end, CRC)).uint32();
  if (claimed !== 0 && claimed !== crc32Final(crc)) throw new ReadFailure("chunk_damaged", `the attachment at byte ${at}`);
  const first = await source.read(body, Math.min(READ_AHEAD, length - HEAD));
  // Its index: both times, the size of the data, and both names.
  const names = fieldsUpTo(first, 16, 2);
  const size = first.subarray(16 + names.length, 16 + names.length + 8);
  const indexFields = new Uint8Array(16 + 8 + names.length);
  indexFields.set(first.subarray(0, 16));
  indexFields.set(size, 16);
  indexFields.set(names, 24);
  return { op: OP.attachment, at, length, indexFields };
}

/** The bytes of `count` texts with their lengths, from `start` on. */
function fieldsUpTo(body: Uint8Array, start: number, count: number): Uint8Array {
  const fields = new Fields(body);
  fields.skip(start);
  for (let number = 0; number < count; number++) fields.bytes(fields.uint32());
  return body.slice(start, body.length - fields.left);
}
