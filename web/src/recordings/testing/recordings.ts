/** Small recordings for tests: ROS 1 bags (wiki.ros.org/Bags/Format/2.0), MCAP files, and a store that serves them. */

import { ReadFailure } from "../failures";
import { joined } from "../formats/recording";
import { McapWriter } from "@mcap/core";
import { Ranges } from "../ranges";

export interface BagMessage {
  connection: number;
  timeNs: bigint;
  data: Uint8Array;
}

export interface BagConnection {
  topic: string;
  type: string;
  definition: string;
}

interface MadeChunk {
  at: number;
  messages: readonly BagMessage[];
}

const TEXT = new TextEncoder();
const HEADER_LENGTH = 4096;

/** `chunks`: messages by chunk; `compress` packs a chunk's records and names how; `spans`: false times of the index. */
export function madeBag(
  connections: readonly BagConnection[],
  chunks: readonly (readonly BagMessage[])[],
  compress: (bytes: Uint8Array) => { name: string; bytes: Uint8Array } = (bytes) => ({ name: "none", bytes }),
  { spans = [] }: { spans?: readonly (readonly [bigint, bigint])[] } = {},
): Uint8Array {
  const parts: Uint8Array[] = [TEXT.encode("#ROSBAG V2.0\n"), new Uint8Array(HEADER_LENGTH)];
  const made: MadeChunk[] = [];
  for (const messages of chunks) {
    made.push({ at: joined(parts).length, messages });
    const first = made.length === 1 ? connections.map(connectionRecord) : [];
    parts.push(...chunkRecords(first, messages, compress));
  }
  const indexAt = joined(parts).length;
  connections.forEach((connection, id) => parts.push(connectionRecord(connection, id)));
  for (const [number, chunk] of made.entries()) parts.push(chunkInfo(chunk, spans[number]));
  parts[1] = bagHeader(indexAt, connections.length, chunks.length);
  return joined(parts);
}

function chunkRecords(
  before: readonly Uint8Array[],
  messages: readonly BagMessage[],
  compress: (bytes: Uint8Array) => { name: string; bytes: Uint8Array },
): Uint8Array[] {
  const records = [...before];
  const places = new Map<number, Uint8Array[]>();
  let at = joined(before).length;
  for (const { connection, timeNs, data } of messages) {
    const bytes = record({ op: byte(2), conn: u32(connection), time: time(timeNs) }, data);
    places.set(connection, [...(places.get(connection) ?? []), time(timeNs), u32(at)]);
    records.push(bytes);
    at += bytes.length;
  }
  const packed = compress(joined(records));
  const chunk = record({ op: byte(5), compression: TEXT.encode(packed.name), size: u32(at) }, packed.bytes);
  const indexes = [...places].map(([connection, entries]) =>
    record({ op: byte(4), ver: u32(1), conn: u32(connection), count: u32(entries.length / 2) }, joined(entries)),
  );
  return [chunk, ...indexes];
}

function chunkInfo({ at, messages }: MadeChunk, span?: readonly [bigint, bigint]): Uint8Array {
  const times = messages.map(({ timeNs }) => timeNs).sort((a, b) => (a < b ? -1 : 1));
  const counts = new Map<number, number>();
  for (const { connection } of messages) counts.set(connection, (counts.get(connection) ?? 0) + 1);
  return record(
    {
      op: byte(6),
      ver: u32(1),
      chunk_pos: u64(at),
      start_time: time(span?.[0] ?? times[0] ?? 0n),
      end_time: time(span?.[1] ?? times.at(-1) ?? 0n),
      count: u32(counts.size),
    },
    joined([...counts].map(([connection, count]) => joined([u32(connection), u32(count)]))),
  );
}

function connectionRecord({ topic, type, definition }: BagConnection, id: number): Uint8Array {
  const about = { topic: TEXT.encode(topic), type: TEXT.encode(type), md5sum: TEXT.encode("*"), message_definition: TEXT.encode(definition) };
  return record({ op: byte(7), conn: u32(id), topic: TEXT.encode(topic) }, fields(about));
}

function bagHeader(indexAt: number, connections: number, chunks: number): Uint8Array {
  const about = { op: byte(3), index_pos: u64(indexAt), conn_count: u32(connections), chunk_count: u32(chunks) };
  const bare = record(about, new Uint8Array());
  return record(about, new Uint8Array(HEADER_LENGTH - bare.length).fill(0x20));
}

function record(head: Record<string, Uint8Array>, data: Uint8Array): Uint8Array {
  const header = fields(head);
  return joined([u32(header.length), header, u32(data.length), data]);
}

function fields(values: Record<string, Uint8Array>): Uint8Array {
  return joined(Object.entries(values).flatMap(([name, value]) => [u32(name.length + 1 + value.length), TEXT.encode(`${name}=`), value]));
}

function byte(value: number): Uint8Array {
  return Uint8Array.of(value);
}

function u32(value: number): Uint8Array {
  return new Uint8Array(Uint32Array.of(value).buffer);
}

function u64(value: number): Uint8Array {
  return new Uint8Array(BigUint64Array.of(BigInt(value)).buffer);
}

function time(ns: bigint): Uint8Array {
  return joined([u32(Number(ns / 1_000_000_000n)), u32(Number(ns % 1_000_000_000n))]);
}

export interface MadeMessage {
  topic: string;
  logTimeNs: bigint;
  data: Uint8Array;
}

export interface MadeTopic {
  name: string;
  schema: { name: string; encoding: string; data: Uint8Array };
  messageEncoding: string;
}

export async function madeMcap(topics: MadeTopic[], messages: MadeMessage[], { chunkSize = 4096, isClosed = true } = {}): Promise<Uint8Array> {
  const parts: Uint8Array[] = [];
  let position = 0n;
  const writable = {
    position: () => position,
    write: (bytes: Uint8Array) => {
      parts.push(bytes.slice());
      position += BigInt(bytes.length);
      return Promise.resolve();
    },
  };
  const writer = new McapWriter({ writable, chunkSize });
  await writer.start({ profile: "", library: "test" });
  const channels = new Map<string, number>();
  for (const { name, schema, messageEncoding } of topics) {
    const schemaId = await writer.registerSchema(schema);
    channels.set(name, await writer.registerChannel({ topic: name, schemaId, messageEncoding, metadata: new Map() }));
  }
  for (const [sequence, { topic, logTimeNs, data }] of messages.entries()) {
    const channelId = channels.get(topic) ?? -1;
    await writer.addMessage({ channelId, sequence, logTime: logTimeNs, publishTime: logTimeNs, data });
  }
  if (isClosed) await writer.end();
  return joined(parts);
}

export interface TestStore {
  ranges: Ranges;
  /** Bytes of each answer. */
  answers: number[];
  /** How often a URL was requested. */
  renewals: () => number;
  /** From now on, addresses given before are refused. */
  expire: () => void;
  /** From now on, no URL is given. */
  refuse: () => void;
  /** Makes the next requests fail as by the network. */
  interrupt: (requests: number) => void;
  change: (bytes: Uint8Array) => void;
}

export function storeOf(bytes: Uint8Array, { lifeMs = 3_600_000, now = Date.now, fetchesNext = false } = {}): TestStore {
  let stored = bytes;
  let etag = '"1"';
  let renewals = 0;
  let valid = 0;
  let isRefusing = false;
  let interruptions = 0;
  const answers: number[] = [];
  const answer: typeof fetch = (url, options) => {
    options?.signal?.throwIfAborted();
    if (interruptions > 0) {
      interruptions -= 1;
      return Promise.reject(new TypeError("Failed to fetch"));
    }
    if (Number(new URL(url as string).searchParams.get("n")) < valid) return Promise.resolve(new Response("", { status: 403 }));
    const [, from = "0", to = "0"] = /bytes=(\d+)-(\d+)/.exec(new Headers(options?.headers).get("range") ?? "") ?? [];
    const body = stored.slice(Number(from), Number(to) + 1);
    answers.push(body.length);
    const headers = { "content-range": `bytes ${from}-${to}/${stored.length}`, etag };
    return Promise.resolve(new Response(body, { status: 206, headers }));
  };
  const ranges = new Ranges({
    sizeBytes: bytes.length,
    fetchesNext,
    renew: () => {
      renewals += 1;
      if (isRefusing) return Promise.reject(new ReadFailure("link_refused"));
      return Promise.resolve({ url: `http://store.test/file?n=${renewals}`, expiresAtMs: Date.now() + lifeMs });
    },
    fetch: answer,
    now,
  });
  return {
    ranges,
    answers,
    renewals: () => renewals,
    expire: () => (valid = renewals + 1),
    refuse: () => (isRefusing = true),
    interrupt: (requests) => (interruptions = requests),
    change: (changed) => {
      stored = changed;
      etag = '"2"';
    },
  };
}
