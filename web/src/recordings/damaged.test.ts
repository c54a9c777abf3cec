import { parse } from "@foxglove/rosmsg";
import { MessageWriter as Ros2Writer } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { describe, expect, it } from "vitest";
import { openRecording } from "./formats/open";
import { joined } from "./formats/recording";
import { MAX_WHOLE_PACKED } from "./limits";
import type { CurvesRequest } from "./protocol";
import { Session } from "./session";
import { madeBag, madeMcap, storeOf } from "./testing/recordings";

const COUNT = 1000;
const VECTOR = "float64 x\n";
const timeOf = (number: number): bigint => 1_700_000_000_000_000_000n + BigInt(number) * 10_000_000n;
const ALL: CurvesRequest = { topic: "/wave", fields: ["x"], fromNs: 0n, toNs: timeOf(COUNT), maxBytes: Infinity };
const quiet = { pause: () => Promise.resolve(), onCurves: () => undefined };

function mcap(): Promise<Uint8Array> {
  const writer = new Ros2Writer(parse(VECTOR, { ros2: true }));
  const schema = { name: "pkg/msg/Vector", encoding: "ros2msg", data: new TextEncoder().encode(VECTOR) };
  const messages = Array.from({ length: COUNT }, (_, number) => {
    return { topic: "/wave", logTimeNs: timeOf(number), data: writer.writeMessage({ x: number }) };
  });
  return madeMcap([{ name: "/wave", schema, messageEncoding: "cdr" }], messages);
}

function bag(): Uint8Array {
  const data = (number: number): Uint8Array => new Uint8Array(Float64Array.of(number).buffer);
  const messages = Array.from({ length: COUNT }, (_, number) => ({ connection: 0, timeNs: timeOf(number), data: data(number) }));
  const chunks = Array.from({ length: COUNT / 50 }, (_, at) => messages.slice(at * 50, at * 50 + 50));
  return madeBag([{ topic: "/wave", type: "pkg/Vector", definition: VECTOR }], chunks);
}

async function chunkOffsets(bytes: Uint8Array): Promise<number[]> {
  const readable = { size: () => Promise.resolve(BigInt(bytes.length)), read: (at: bigint, length: bigint) => Promise.resolve(bytes.slice(Number(at), Number(at + length))) };
  return (await McapIndexedReader.Initialize({ readable })).chunkIndexes.map((chunk) => Number(chunk.chunkStartOffset));
}

async function session(format: "mcap" | "rosbag1", bytes: Uint8Array): Promise<Session> {
  return new Session(await openRecording(format, storeOf(bytes).ranges));
}

/** A zstd frame that holds the bytes as they are: what any decoder must read. Source: RFC 8878, 3.1.1. */
function zstd(bytes: Uint8Array): Uint8Array {
  const head = Uint8Array.of(0x28, 0xb5, 0x2f, 0xfd, 0xa0, ...new Uint8Array(Uint32Array.of(bytes.length).buffer));
  const blocks: Uint8Array[] = [];
  for (let at = 0; at < bytes.length; at += 100_000) {
    const block = bytes.subarray(at, at + 100_000);
    const word = (block.length << 3) | (at + 100_000 >= bytes.length ? 1 : 0);
    blocks.push(Uint8Array.of(word & 255, (word >> 8) & 255, word >> 16), block);
  }
  return joined([head, ...blocks]);
}

describe("a recording with a damaged chunk", () => {
  it("shows the curve with a gap where the chunk was, and says so", async () => {
    const bytes = await mcap();
    const offsets = await chunkOffsets(bytes);
    expect(offsets.length).toBeGreaterThan(3);
    const whole = await (await session("mcap", bytes)).curves(ALL, quiet);
    expect([whole.messages, whole.damaged]).toEqual([COUNT, []]);
    const at = (offsets[1] ?? 0) + 100;
    bytes[at] = (bytes[at] ?? 0) ^ 255; // its checksum no longer fits
    const drawn = await (await session("mcap", bytes)).curves(ALL, quiet);
    const [part] = drawn.damaged;
    expect(drawn.damaged).toHaveLength(1);
    expect(drawn.messages).toBeLessThan(COUNT);
    expect(drawn.messages).toBeGreaterThan(COUNT / 2);
    const middle = ((part?.fromSeconds ?? 0) + (part?.toSeconds ?? 0)) / 2;
    expect(drawn.values[0]?.[drawn.seconds.indexOf(middle)]).toBeNull();
    const inside = drawn.seconds.filter((second) => second >= (part?.fromSeconds ?? 0) && second <= (part?.toSeconds ?? 0));
    expect(inside).toEqual(expect.arrayContaining([middle]));
    expect(drawn.values[0]?.at(-1)).toBe(COUNT - 1);
  });

  it("has no derivative across the chunk", async () => {
    const bytes = await mcap();
    const at = ((await chunkOffsets(bytes))[1] ?? 0) + 100;
    bytes[at] = (bytes[at] ?? 0) ^ 255;
    const { seconds, values, damaged, messages } = await (await session("mcap", bytes)).curves({ ...ALL, fields: ["x", "derivative(x)"] }, quiet);
    const behind = seconds.findIndex((second) => second > (damaged[0]?.toSeconds ?? Infinity));
    expect(values[0]?.[behind]).toBeGreaterThan(1);
    expect(values[1]?.[behind]).toBeNull();
    expect(values[1]?.[behind + 1]).toBeCloseTo(100);
    expect(values[1]?.filter((value) => value !== null)).toHaveLength(messages - 2); // not of the first message, nor of this one
  });

  it("offers the fields of the first message that can be read, though the first chunk is damaged", async () => {
    const bytes = await mcap();
    const at = ((await chunkOffsets(bytes))[0] ?? 0) + 100;
    bytes[at] = (bytes[at] ?? 0) ^ 255;
    const { fields } = await (await session("mcap", bytes)).fields("/wave");
    expect(fields.map(({ path }) => path)).toEqual(["x"]);
  });

  it("is a bag as well", async () => {
    const bytes = bag();
    const name = new TextEncoder().encode("compression=none");
    const places = [...bytes.keys()].filter((at) => name.every((byte, place) => bytes[at + place] === byte));
    bytes.set(new TextEncoder().encode("size"), (places[2] ?? 0) - 4); // the chunk's header is no header now
    bytes.fill(255, (places[2] ?? 0) - 4, (places[2] ?? 0) + 16);
    const drawn = await (await session("rosbag1", bytes)).curves(ALL, quiet);
    expect([drawn.messages, drawn.damaged.length]).toEqual([COUNT - 50, 1]);
  });

  it("fails by name where nothing of the topic can be read", async () => {
    const bytes = await mcap();
    for (const offset of await chunkOffsets(bytes)) bytes[offset + 100] = (bytes[offset + 100] ?? 0) ^ 255;
    await expect((await session("mcap", bytes)).curves(ALL, quiet)).rejects.toThrow(/chunk_damaged/);
    await expect((await session("mcap", bytes)).fields("/wave")).rejects.toThrow(/chunk_damaged/);
  });
});

describe("a file that is compressed as a whole", () => {
  it.each(["mcap", "rosbag1"] as const)("is read as what is inside: %s", async (format) => {
    const packed = zstd(format === "mcap" ? await mcap() : bag());
    const drawn = await (await session(format, packed)).curves(ALL, quiet);
    expect([drawn.messages, drawn.damaged]).toEqual([COUNT, []]);
  });

  it("is read as far as it goes where it breaks off", async () => {
    const packed = zstd(joined([await mcap(), new Uint8Array(200_000)])).slice(0, 100_020);
    const opened = (await session("mcap", packed)).opened();
    expect(opened.topics.map(({ name }) => name)).toEqual(["/wave"]);
    expect(opened.indexedUntil).not.toBeNull();
  });

  it("says what to do instead where it is too large to hold", async () => {
    const packed = zstd(await mcap());
    const source = { sizeBytes: MAX_WHOLE_PACKED + 1, ahead: 0, bytesRead: 0, read: (at: number, length: number) => Promise.resolve(packed.subarray(at, at + length)) };
    await expect(openRecording("mcap", source)).rejects.toThrow(/compressed_whole/);
  });

  it("takes no more memory than the bound, whatever its header claims", async () => {
    const hostile = Uint8Array.of(0x28, 0xb5, 0x2f, 0xfd, 0x00, 0xff, ...new Uint8Array(64));
    await expect(openRecording("mcap", storeOf(hostile).ranges)).rejects.toThrow(/compressed_whole/);
  });
});
