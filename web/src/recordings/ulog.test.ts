import { describe, expect, it } from "vitest";
import { decoderOf } from "./decoding/decoder";
import { fieldTree, numberAt } from "./decoding/fields";
import { openRecording } from "./formats/open";
import { joined, type Damage, type Message, type Recording } from "./formats/recording";
import { storeOf } from "./testing/recordings";

const TEXT = new TextEncoder();
const ALL = { fromNs: 0n, toNs: 2n ** 62n };
const START_US = 1_000_000n;
const SYNC = message("S", Uint8Array.of(0x2f, 0x73, 0x13, 0x20, 0x25, 0x0c, 0xbb, 0x12));
const FORMATS = [
  message("F", TEXT.encode("pose:uint64_t timestamp;point at;float[2] q;uint8_t[4] _padding0;")),
  message("F", TEXT.encode("point:double x;double y;")),
  message("F", TEXT.encode("late:uint8_t level;uint64_t timestamp;")),
];
const TOPICS = [subscribe(0, 7, "pose"), subscribe(2, 8, "pose"), subscribe(0, 9, "late"), subscribe(0, 10, "silent")];

function message(kind: string, body: Uint8Array): Uint8Array {
  const head = new Uint8Array(3);
  new DataView(head.buffer).setUint16(0, body.length, true);
  head[2] = kind.charCodeAt(0);
  return joined([head, body]);
}

function subscribe(instance: number, id: number, name: string): Uint8Array {
  return message("A", joined([Uint8Array.of(instance, id & 255, id >> 8), TEXT.encode(name)]));
}

function header(): Uint8Array {
  const bytes = new Uint8Array(16);
  bytes.set([0x55, 0x4c, 0x6f, 0x67, 0x01, 0x12, 0x35, 1]);
  new DataView(bytes.buffer).setBigUint64(8, START_US, true);
  return bytes;
}

/** A pose, without the padding at its end, as a logger writes it. */
function pose(id: number, stampUs: bigint, x: number): Uint8Array {
  const view = new DataView(new ArrayBuffer(2 + 32));
  view.setUint16(0, id, true);
  view.setBigUint64(2, stampUs, true);
  view.setFloat64(10, x, true);
  view.setFloat64(18, -x, true);
  view.setFloat32(26, 0.5, true);
  view.setFloat32(30, 2, true);
  return message("D", new Uint8Array(view.buffer));
}

function late(stampUs: bigint): Uint8Array {
  const view = new DataView(new ArrayBuffer(11));
  view.setUint16(0, 9, true);
  view.setBigUint64(3, stampUs, true);
  return message("D", new Uint8Array(view.buffer));
}

function flags(offset: number, incompatible = 1): Uint8Array {
  const view = new DataView(new ArrayBuffer(40));
  view.setUint8(8, incompatible);
  view.setBigUint64(16, BigInt(offset), true);
  return message("B", new Uint8Array(view.buffer));
}

function open(parts: readonly Uint8Array[], maxBytes?: number): Promise<Recording> {
  return openRecording("ulog", storeOf(joined(parts)).ranges, { maxBytes });
}

async function read(recording: Recording, topic: string, span = ALL): Promise<{ messages: Message[]; damage: Damage[] }> {
  const [messages, damage]: [Message[], Damage[]] = [[], []];
  for await (const one of recording.messages([topic], span, "forward", (part) => damage.push(part))) messages.push(one);
  return { messages, damage };
}

async function valuesOf(recording: Recording, topic: string, ...path: string[]): Promise<(readonly [bigint, number | null])[]> {
  const { messages } = await read(recording, topic);
  const [first] = messages;
  if (first === undefined) return [];
  const decode = decoderOf(first.channel.schema);
  return messages.map(({ logTimeNs, data }) => [logTimeNs / 1000n, numberAt(decode(data), path)] as const);
}

describe("a flight log", () => {
  it("has its topics with their instances, and nested fields, by time", async () => {
    const data = [pose(7, 1_000_030n, 3), pose(8, 1_000_001n, 9), pose(7, 1_000_010n, 1), late(1_000_020n)];
    const recording = await open([header(), ...FORMATS, ...TOPICS, ...data]);
    expect(recording.topics.map(({ name }) => name)).toEqual(["pose", "pose#2", "late"]);
    expect(recording.span).toEqual({ fromNs: 1_000_001_000n, toNs: 1_000_030_000n });
    expect(recording.indexedUntil).toBeNull();
    expect(await valuesOf(recording, "pose", "at", "x")).toEqual([[1_000_010n, 1], [1_000_030n, 3]]);
    expect(await valuesOf(recording, "pose#2", "at", "y")).toEqual([[1_000_001n, -9]]);
    const { messages } = await read(recording, "pose", { fromNs: 1_000_011_000n, toNs: 1_000_030_000n });
    expect(messages).toHaveLength(1);
    const [only] = messages as [Message];
    expect(fieldTree(decoderOf(only.channel.schema)(only.data)).map(({ label }) => label)).toEqual(["timestamp", "at", "q"]);
  });

  it("dates what was published before it at its beginning, and leaves out what has no time", async () => {
    const recording = await open([header(), ...FORMATS, ...TOPICS, pose(7, 5n, 1), pose(7, 2n ** 64n - 1n, 2), message("D", Uint8Array.of(7, 0, 1)), pose(99, 1_000_001n, 1)]);
    expect(await valuesOf(recording, "pose", "at", "x")).toEqual([[START_US, 1]]);
    expect(recording.topics.map(({ name }) => name)).toEqual(["pose"]);
  });

  it("continues behind damage at the next sync message, and reports the damage", async () => {
    const noise = Uint8Array.from({ length: 500_000 }, () => 0xee);
    const recording = await open([header(), ...FORMATS, ...TOPICS, pose(7, 1_000_001n, 1), noise, SYNC, pose(7, 1_000_002n, 2)]);
    expect(await valuesOf(recording, "pose", "at", "x")).toEqual([[1_000_001n, 1], [1_000_002n, 2]]);
    expect((await read(recording, "pose")).damage.map(({ failure }) => failure.code)).toEqual(["chunk_damaged"]);
    expect(await valuesOf(await open([header(), ...FORMATS, ...TOPICS, pose(7, 1_000_001n, 1), noise]), "pose", "at", "x")).toHaveLength(1);
  });

  it("reads data that were appended, although they cut the message before them", async () => {
    const front = joined([header(), flags(0), ...FORMATS, ...TOPICS, pose(7, 1_000_001n, 1), pose(7, 1_000_002n, 2).subarray(0, 20)]);
    const bytes = joined([front, pose(7, 1_000_003n, 3)]);
    bytes.set(flags(front.length), 16);
    expect(await valuesOf(await open([bytes]), "pose", "at", "x")).toEqual([[1_000_001n, 1], [1_000_003n, 3]]);
    await expect(open([header(), flags(0, 2)])).rejects.toMatchObject({ code: "not_readable_here" });
  });

  it("is read as far as a limit reaches, in bounded parts", async () => {
    const many = Array.from({ length: 40_000 }, (_, at) => pose(7, START_US + BigInt(at), at));
    const recording = await open([header(), ...FORMATS, ...TOPICS, ...many], 1_000_000);
    expect(recording.indexedUntil).toBe(1_000_000);
    const values = await valuesOf(recording, "pose", "at", "x");
    expect(values.length).toBeGreaterThan(25_000);
    expect(values.every(([timeUs, x], at) => x === at && timeUs === START_US + BigInt(at))).toBe(true);
    expect(Math.max(...recording.pieces(["pose"], ALL).map(({ bytes }) => bytes))).toBeLessThan(400_000);
  });

  it("survives definitions that contain themselves, and files that are none", async () => {
    const itself = message("F", TEXT.encode("loop:loop inner;uint64_t timestamp;"));
    const recording = await open([header(), itself, subscribe(0, 7, "loop"), pose(7, 1_000_001n, 1)]);
    expect(recording.topics).toEqual([]);
    for (const bytes of [new Uint8Array(0), new Uint8Array(16), header().subarray(0, 12)]) {
      await expect(open([bytes])).rejects.toMatchObject({ code: "not_readable_here" });
    }
  });
});
