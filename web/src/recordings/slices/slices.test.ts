// @vitest-environment node
import { McapIndexedReader } from "@mcap/core";
import { describe, expect, it } from "vitest";
import { openRecording } from "../formats/open";
import { joined } from "../formats/recording";
import { madeBag, madeMcap, storeOf, type TestStore } from "../testing/recordings";
import { publisherCount } from "./latched";
import { pythonJson, writeSlice, type SliceRequest } from "./slice";

const START = 1_700_000_000_000_000_000n;
const SECOND = 1_000_000_000n;
const COUNT = 200;
/** The opcode of the record. */
const STATISTICS = 0x0b;
const text = (words: string): Uint8Array => new TextEncoder().encode(words);
const WHOLE: SliceRequest = { topics: null, startNs: null, endNs: null, fileName: "drive.mcap", sha256: "ab", version: "1" };

/** `size`: of the padding of each message. */
async function drive(size = 200, chunkSize = 4096): Promise<TestStore> {
  const topic = (name: string) => ({ name, schema: { name: "Words", encoding: "jsonschema", data: text("{}") }, messageEncoding: "json" });
  const messages = Array.from({ length: COUNT }, (_, number) => {
    const logTimeNs = START + BigInt(number) * SECOND;
    const own = ["/a", "/b"].map((name) => ({ topic: name, logTimeNs, data: text(`${name} ${number} ${"x".repeat(size)}`) }));
    return number % 50 === 0 ? [...own, { topic: "/robot_description", logTimeNs, data: text(`robot ${number}`) }] : own;
  });
  return storeOf(await madeMcap(["/a", "/b", "/silent", "/robot_description"].map(topic), messages.flat(), { chunkSize }));
}

/** Some megabytes, which are read by several requests and written in several parts. */
const longDrive = (): Promise<TestStore> => drive(20_000, 2 ** 18);

interface SliceOptions {
  format?: "mcap" | "rosbag1";
  /** Called after each part that is written. */
  onWrite?: (count: number) => void;
  signal?: AbortSignal;
}

async function sliceOf(store: TestStore, request: Partial<SliceRequest>, { format = "mcap", onWrite, signal }: SliceOptions = {}): Promise<Uint8Array> {
  const parts: Uint8Array[] = [];
  const recording = await openRecording(format, store.ranges);
  await writeSlice(recording, { ...WHOLE, ...request }, {
    compression: { name: "", compress: (raw) => raw },
    write: (bytes) => {
      parts.push(bytes);
      onWrite?.(parts.length);
      return Promise.resolve();
    },
    onProgress: () => undefined,
    signal: signal ?? new AbortController().signal,
  });
  return joined(parts);
}

async function read(bytes: Uint8Array) {
  const readable = { size: () => Promise.resolve(BigInt(bytes.length)), read: (at: bigint, length: bigint) => Promise.resolve(bytes.slice(Number(at), Number(at + length))) };
  const reader = await McapIndexedReader.Initialize({ readable });
  const messages: string[] = [];
  const times: bigint[] = [];
  for await (const { data, logTime } of reader.readMessages({ validateCrcs: true })) {
    messages.push(new TextDecoder().decode(data).replace(/ x+$/, ""));
    times.push(logTime);
  }
  let madeFrom = new Map<string, string>();
  for await (const { name, metadata } of reader.readMetadata()) if (name === "kleinkram:made_from") madeFrom = metadata;
  return { reader, messages, times, madeFrom };
}

describe("a slice", () => {
  it("holds the selected messages, from the start to before the end, and says what it was made from", async () => {
    const { messages, times, madeFrom, reader } = await read(await sliceOf(await drive(), { topics: ["/b"], startNs: START + 20n * SECOND, endNs: START + 30n * SECOND }));
    expect(messages).toEqual(Array.from({ length: 10 }, (_, number) => `/b ${20 + number}`));
    expect([times[0], times.at(-1)]).toEqual([START + 20n * SECOND, START + 29n * SECOND]);
    expect([...madeFrom]).toEqual([
      ["version", "1"], ["files", '[{"name": "drive.mcap", "sha256": "ab"}]'], ["topics", '["/b"]'],
      ["start_ns", String(START + 20n * SECOND)], ["end_ns", String(START + 30n * SECOND)],
    ]);
    expect([reader.statistics?.messageCount, reader.header.library]).toEqual([10n, "kleinkram 1"]);
  });

  it("of everything holds all messages and the silent topics", async () => {
    const { messages, madeFrom, reader } = await read(await sliceOf(await drive(), {}));
    expect(messages.length).toBe(2 * COUNT + COUNT / 50);
    expect([...reader.channelsById.values()].map(({ topic }) => topic)).toContain("/silent");
    expect(madeFrom.has("topics")).toBe(false);
  });

  it("begins with the last message of a latched topic before its start", async () => {
    const startNs = START + 120n * SECOND;
    const { messages, times, madeFrom } = await read(await sliceOf(await drive(), { topics: ["/a", "/robot_description"], startNs, endNs: startNs + 2n * SECOND }));
    expect([messages, times[0]]).toEqual([["robot 100", "/a 120", "/a 121"], startNs]);
    expect(madeFrom.get("latched")).toBe(`{"/robot_description": [${START + 100n * SECOND}]}`);
  });

  it("begins with latched messages of one time in their order, so that the last one of a frame stays the last", async () => {
    const schema = { name: "Transforms", encoding: "jsonschema", data: text("{}") };
    const transforms = (...frames: string[]) => text(JSON.stringify({ transforms: frames.map((name) => ({ child_frame_id: name })) }));
    const both = { topic: "/tf_static", logTimeNs: START, data: transforms("a", "b") };
    const store = storeOf(await madeMcap([{ name: "/tf_static", schema, messageEncoding: "json" }], [both, { ...both, data: transforms("a") }, { ...both, logTimeNs: START + 9n }]));
    const { messages } = await read(await sliceOf(store, { startNs: START + 5n }));
    expect(messages.map((message) => message.length)).toEqual([both, { data: transforms("a") }, both].map(({ data }) => data.length));
  });

  it("reads only the chunks that are needed", async () => {
    const store = await drive();
    await sliceOf(store, { topics: ["/b"], startNs: START + 20n * SECOND, endNs: START + 21n * SECOND });
    expect(store.answers.length).toBeLessThanOrEqual(3);
  });

  it("of a bag has the profile and the properties of its connections", async () => {
    const data = text("12345678");
    const store = storeOf(madeBag([{ topic: "/x", type: "a/B", definition: "float64 x\n" }], [[{ connection: 0, timeNs: START, data }]]));
    const { reader } = await read(await sliceOf(store, {}, { format: "rosbag1" }));
    expect(reader.header.profile).toBe("ros1");
    expect([...reader.channelsById.values()][0]).toMatchObject({ topic: "/x", messageEncoding: "ros1", metadata: new Map([["md5sum", "*"]]) });
  });

  it.each([
    [{ startNs: START + 900n * SECOND }, "range_outside"],
    [{ topics: ["/none"] }, "topic_unknown"],
  ] as const)("is refused for %o", async (request, code) => {
    await expect(sliceOf(await drive(), request)).rejects.toMatchObject({ code });
  });

  it("is refused where a chunk is damaged, and where the recording was not closed", async () => {
    const whole = await drive();
    const bytes = (await whole.ranges.read(0, whole.ranges.sizeBytes)).slice();
    bytes[Math.floor(bytes.length / 3)] = (bytes[Math.floor(bytes.length / 3)] ?? 0) ^ 0xff;
    await expect(sliceOf(storeOf(bytes), {})).rejects.toMatchObject({ code: "not_sliceable", detail: "a part of it is damaged" });
    await expect(sliceOf(storeOf(bytes.slice(0, bytes.length / 4)), {})).rejects.toMatchObject({ code: "not_sliceable" });
  });
});

describe("a slice that is disturbed", () => {
  it("has the same bytes if URLs expire meanwhile, which are renewed", async () => {
    const store = await longDrive();
    const sliced = await sliceOf(store, {}, { onWrite: store.expire });
    expect(store.renewals()).toBeGreaterThan(1);
    const undisturbed = await sliceOf(await longDrive(), {});
    expect(sliced.length).toBe(undisturbed.length);
    expect(sliced.every((byte, at) => byte === undisturbed[at])).toBe(true);
  });

  it("fails if the file changes meanwhile", async () => {
    const store = await longDrive();
    const bytes = await store.ranges.read(0, store.ranges.sizeBytes);
    const fresh = storeOf(bytes);
    await expect(sliceOf(fresh, {}, { onWrite: () => fresh.change(bytes) })).rejects.toMatchObject({ code: "file_changed" });
  });

  it("fails if no URL is given any more, as after the person signed out", async () => {
    const store = await longDrive();
    const onWrite = (): void => {
      store.expire();
      store.refuse();
    };
    await expect(sliceOf(store, {}, { onWrite })).rejects.toMatchObject({ code: "link_refused" });
  });

  it("ends soon after it is cancelled", async () => {
    const controller = new AbortController();
    let written = 0;
    const onWrite = (count: number): void => {
      written = count;
      controller.abort();
    };
    await expect(sliceOf(await longDrive(), {}, { onWrite, signal: controller.signal })).rejects.toMatchObject({ code: "cancelled" });
    expect(written).toBe(1);
  });
});

describe("a slice of a recording with a wrong index", () => {
  const second = (number: number): bigint => START + BigInt(number) * SECOND;
  const messages = [0, 1, 2].map((number) => ({ connection: 0, timeNs: second(number), data: text("12345678") }));
  const late = { connection: 0, timeNs: second(20), data: text("12345678") };
  const connections = [{ topic: "/x", type: "a/B", definition: "float64 x\n" }];
  const wrongBag = (...spans: [bigint, bigint][]): TestStore => storeOf(madeBag(connections, [messages, [late]], undefined, { spans }));
  const refused = { code: "not_sliceable" };

  it.each([
    ["says that its messages end earlier", [second(0), second(1)]],
    ["says that they begin later", [second(1), second(2)]],
    ["contradicts itself", [second(2), second(0)]],
  ] as [string, [bigint, bigint]][])("is refused: it %s", async (_, span) => {
    await expect(sliceOf(wrongBag(span), {}, { format: "rosbag1" })).rejects.toMatchObject(refused);
  });

  it("is refused if the index hides all that is selected", async () => {
    const request = { startNs: second(1), endNs: second(3) };
    await expect(sliceOf(wrongBag([second(0), second(0)]), request, { format: "rosbag1" })).rejects.toMatchObject(refused);
  });

  it("is refused if the statistics of an MCAP contradict it", async () => {
    const { ranges } = await drive();
    const bytes = await ranges.read(0, ranges.sizeBytes);
    const view = new DataView(bytes.buffer);
    let at = Number(view.getBigUint64(bytes.length - 28, true)); // where the summary starts
    while (bytes[at] !== STATISTICS) at += 9 + Number(view.getBigUint64(at + 1, true));
    view.setBigUint64(at + 35, START - SECOND, true); // the time of the first message
    view.setUint32(bytes.length - 12, 0, true); // no checksum of the summary
    await expect(sliceOf(storeOf(bytes), {})).rejects.toMatchObject({ detail: "its index contradicts itself" });
  });
});

describe("latched topics", () => {
  const channel = (topic: string, ...properties: [string, string][]) => ({ topic, properties, schema: { name: "", encoding: "", messageEncoding: "cdr", definition: new Uint8Array() } });

  it("have a publisher for each profile, connection or well-known name", () => {
    const profiles = "- durability: 1\n  depth: 1\n- durability: 2\n- durability: transient_local\n";
    expect(publisherCount(channel("/map", ["offered_qos_profiles", profiles]))).toBe(2);
    expect(publisherCount(channel("/map", ["latching", "1"]))).toBe(1);
    expect(publisherCount(channel("/robot/tf_static"))).toBe(1);
    expect(publisherCount(channel("/imu", ["latching", "0"]))).toBe(0);
  });
});

it("writes JSON as Python does", () => {
  expect(pythonJson({ "/ä": ["a\"b\n", "\u{1f600}\u007f"], n: [1n, 2n] })).toBe('{"/\\u00e4": ["a\\"b\\n", "\\ud83d\\ude00\\u007f"], "n": [1, 2]}');
});
