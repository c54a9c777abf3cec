import { parse } from "@foxglove/rosmsg";
import { MessageWriter as Ros1Writer } from "@foxglove/rosmsg-serialization";
import { MessageWriter as Ros2Writer } from "@foxglove/rosmsg2-serialization";
import { describe, expect, it, vi } from "vitest";
import { ReadFailure } from "./failures";
import { openRecording } from "./formats/open";
import { pictureOf, type Picture } from "./pictures/picture";
import { makers, type Which } from "./products/products";
import type { CurvesRequest, DamagedPart } from "./protocol";
import { Session } from "./session";
import { madeBag, madeMcap, storeOf, type BagMessage, type MadeMessage } from "./testing/recordings";

const START = 1_700_000_000_000_000_000n;
const RATE_HZ = 100;
const COUNT = 2_000;
const VECTOR = "float64 x\nfloat64 y\n";
const IMAGE = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n";

const wave = (number: number): number => Math.sin(number / 30);
const timeOf = (number: number): bigint => START + BigInt(number) * 10_000_000n;
const image = (number: number): object => ({ height: 4, width: 4, encoding: "mono8", is_bigendian: 0, step: 4, data: new Uint8Array(16).fill(number % 256) });
/** A picture every second from the third on; between them, much of another topic. */
const isPicture = (number: number): boolean => number >= 300 && number % 100 === 0;

async function mcap(): Promise<Uint8Array> {
  const vector = new Ros2Writer(parse(VECTOR, { ros2: true }));
  const pictures = new Ros2Writer(parse(IMAGE, { ros2: true }));
  const text = (definition: string): Uint8Array => new TextEncoder().encode(definition);
  const topics = [
    { name: "/wave", schema: { name: "pkg/msg/Vector", encoding: "ros2msg", data: text(VECTOR) }, messageEncoding: "cdr" },
    { name: "/camera", schema: { name: "sensor_msgs/msg/Image", encoding: "ros2msg", data: text(IMAGE) }, messageEncoding: "cdr" },
    { name: "/words", schema: { name: "Words", encoding: "jsonschema", data: text("{}") }, messageEncoding: "json" },
    { name: "/silent", schema: { name: "Words", encoding: "jsonschema", data: text("{}") }, messageEncoding: "json" },
  ];
  const messages = Array.from({ length: COUNT }, (_, number): MadeMessage[] => {
    const logTimeNs = timeOf(number);
    const wavy = { topic: "/wave", logTimeNs, data: vector.writeMessage({ x: wave(number), y: number }) };
    const words = { topic: "/words", logTimeNs, data: text(JSON.stringify({ n: number, deep: [{ m: -number }] })) };
    return isPicture(number) ? [wavy, words, { topic: "/camera", logTimeNs, data: pictures.writeMessage(image(number)) }] : [wavy, words];
  });
  return madeMcap(topics, messages.flat());
}

function bag(): Uint8Array {
  const vector = new Ros1Writer(parse(VECTOR));
  const pictures = new Ros1Writer(parse(IMAGE));
  const messages = Array.from({ length: COUNT }, (_, number): BagMessage[] => {
    const wavy = { connection: 0, timeNs: timeOf(number), data: vector.writeMessage({ x: wave(number), y: number }) };
    return isPicture(number) ? [wavy, { connection: 1, timeNs: timeOf(number), data: pictures.writeMessage(image(number)) }] : [wavy];
  }).flat();
  const size = 50;
  const chunks = Array.from({ length: Math.ceil(messages.length / size) }, (_, at) => messages.slice(at * size, at * size + size));
  // Messages that come late: the last of each chunk changes places with the first of the next.
  chunks.forEach((chunk, at) => {
    const next = chunks[at + 1];
    const [late, early] = [chunk.at(-1), next?.[0]];
    if (next === undefined || late === undefined || early === undefined) return;
    chunk[chunk.length - 1] = early;
    next[0] = late;
  });
  return madeBag(
    [
      { topic: "/wave", type: "pkg/Vector", definition: VECTOR },
      { topic: "/camera", type: "sensor_msgs/Image", definition: IMAGE },
    ],
    chunks,
  );
}

const MADE = { mcap: mcap(), rosbag1: Promise.resolve(bag()) } as const;

async function opened(format: keyof typeof MADE): Promise<{ session: Session; read: () => number; size: number }> {
  const bytes = await MADE[format];
  const { ranges } = storeOf(bytes);
  return { session: new Session(await openRecording(format, ranges)), read: () => ranges.bytesRead, size: bytes.length };
}

function request(more: Partial<CurvesRequest> = {}): CurvesRequest {
  return { topic: "/wave", fields: ["x", "y"], fromNs: START, toNs: timeOf(COUNT), maxBytes: Infinity, ...more };
}

const quiet = { pause: () => Promise.resolve(), onCurves: () => undefined };

/** The picture of a message, as the worker decodes it before it makes a bitmap. */
async function pictureAt(session: Session, atNs: bigint, which: Which = "nearest", topic = "/camera"): Promise<{ logTimeNs: bigint; picture: Picture; damaged: DamagedPart[] } | null> {
  const decoded: Picture[] = [];
  vi.spyOn(makers, "picture").mockImplementation((_, decode) => {
    decoded.push(pictureOf(decode()));
    return null as never;
  });
  const { message, damaged } = await session.message({ topic, which, atNs, product: "picture", shownNs: null, maxBytes: Infinity });
  const [picture] = decoded;
  return message === null || picture === undefined ? null : { logTimeNs: message.logTimeNs, picture, damaged };
}

/** A clock that goes on by so many milliseconds each time. */
function mockedClock(stepMs: number): () => number {
  let now = 0;
  return () => (now += stepMs);
}

function shade(shown: { picture: { data: Uint8Array } } | null): number | undefined {
  return shown?.picture.data[0];
}

describe.each(["mcap", "rosbag1"] as const)("a session with %s", (format) => {
  it("knows its topics and its span", async () => {
    const { session } = await opened(format);
    const { span, topics } = session.opened();
    expect(span).toEqual({ fromNs: START, toNs: timeOf(COUNT - 1) });
    expect(topics.map(({ name }) => name)).toEqual(expect.arrayContaining(["/wave", "/camera"]));
  });

  it("shows the first picture at or after a time, and its neighbours", async () => {
    const { session } = await opened(format);
    const at = (atNs: bigint, which: Which) => pictureAt(session, atNs, which);
    const first = await at(START, "nearest");
    expect(first?.logTimeNs).toBe(timeOf(300));
    expect(shade(first)).toBe(300 % 256);
    expect((await at(timeOf(301), "nearest"))?.logTimeNs).toBe(timeOf(400));
    expect((await at(timeOf(400), "next"))?.logTimeNs).toBe(timeOf(500));
    expect((await at(timeOf(400), "previous"))?.logTimeNs).toBe(timeOf(300));
    expect((await at(timeOf(300), "previous"))).toBeNull();
    expect((await at(timeOf(COUNT), "nearest"))?.logTimeNs).toBe(timeOf(1900));
  });

  it("draws the curve that was recorded, in order, with every point", async () => {
    const { session } = await opened(format);
    const { seconds, values, messages, isWhole } = await session.curves(request(), quiet);
    expect([messages, isWhole]).toEqual([COUNT, true]);
    expect(seconds).toEqual(Array.from({ length: COUNT }, (_, number) => number / RATE_HZ));
    expect(values[0]).toEqual(Array.from({ length: COUNT }, (_, number) => wave(number)));
    expect(values[1]).toEqual(Array.from({ length: COUNT }, (_, number) => number));
  });

  it("reads no more than it may, and says what the whole costs", async () => {
    const { session, size } = await opened(format);
    const { seconds, wholeBytes, topicBytes, untilNs } = await session.curves(request({ maxBytes: size / 4 }), quiet);
    expect(wholeBytes).toBeGreaterThan(size / 2);
    expect(topicBytes).toBe(wholeBytes);
    const part = await session.curves(request({ fromNs: timeOf(COUNT - 10) }), quiet);
    expect(part.topicBytes).toBe(topicBytes);
    expect(part.wholeBytes).toBeLessThan(topicBytes);
    expect(untilNs).toBeLessThan(timeOf(COUNT / 2));
    expect(seconds.at(-1)).toBeGreaterThan(3);
    expect(seconds.at(-1)).toBeLessThan(8);
  });

  it("offers the numbers of a message", async () => {
    const { session } = await opened(format);
    expect((await session.fields("/wave")).fields.map(({ path }) => path)).toEqual(["x", "y"]);
  });

  it("says in a word what does not work", async () => {
    const { session } = await opened(format);
    await expect(session.fields("/nowhere")).rejects.toMatchObject({ code: "topic_unknown" });
    await expect(pictureAt(session, START, "nearest", "/wave")).rejects.toMatchObject({ code: "not_a_picture" });
  });

  it("ends a curve that is cancelled while it pauses", async () => {
    const { session } = await opened(format);
    vi.spyOn(Date, "now").mockImplementation(mockedClock(1000));
    const pause = vi.fn(() => Promise.reject(new ReadFailure("cancelled")));
    await expect(session.curves(request(), { pause, onCurves: () => undefined })).rejects.toMatchObject({ code: "cancelled" });
    expect(pause).toHaveBeenCalledOnce();
  });

  it("survives damage anywhere: a named failure, or what is there", { timeout: 60_000 }, async () => {
    const made = await MADE[format];
    for (let number = 0; number < 60; number++) {
      const whole = number % 3 === 0 ? made.slice(0, made.length * 0.8) : made;
      const bytes = whole.slice();
      // Half of the damage at the end, where the index is.
      const at = number % 2 ? Math.floor((whole.length * number) / 60) : whole.length - 1 - number * 97;
      bytes.fill(number * 53, at, at + 1 + (number % 9));
      try {
        const session = new Session(await openRecording(format, storeOf(bytes).ranges));
        await session.curves(request(), quiet);
        await pictureAt(session, START);
      } catch (thrown) {
        expect(thrown).toBeInstanceOf(ReadFailure);
      }
    }
  });

  it("makes an index for a recording that was never closed, of as much as it may read", async () => {
    const whole = await MADE[format];
    const cut = whole.slice(0, whole.length * 0.7);
    const session = new Session(await openRecording(format, storeOf(cut).ranges));
    const { span, indexedUntil } = session.opened();
    expect(indexedUntil).toBeGreaterThan(cut.length * 0.9);
    expect(indexedUntil).toBeLessThanOrEqual(cut.length);
    expect(span?.fromNs).toBe(START);
    const { seconds, values } = await session.curves(request(), quiet);
    expect(seconds.length).toBeGreaterThan(COUNT * 0.6);
    expect(values[0]).toEqual(seconds.map((item) => wave(Math.round(item * RATE_HZ))));
    const shown = await pictureAt(session, START);
    expect(shade(shown)).toBe(300 % 256);
    const little = storeOf(cut).ranges;
    const beginning = new Session(await openRecording(format, little, { maxBytes: cut.length / 4 }));
    expect(beginning.opened().indexedUntil).toBeLessThan(cut.length / 2);
  });

  it("says so where there is nothing to make an index of", async () => {
    const whole = await MADE[format];
    // What comes before the first chunk ends.
    const { ranges } = storeOf(whole.slice(0, 4_109 + 40));
    await expect(openRecording(format, ranges)).rejects.toMatchObject({ code: "no_index" });
  });
});

describe("a session", () => {
  it("plots JSON", async () => {
    const { session } = await opened("mcap");
    const { values } = await session.curves(request({ topic: "/words", fields: ["deep[0].m", "n", "missing"] }), quiet);
    expect(values.map((curve) => curve[7])).toEqual([-7, 7, null]);
    await expect(session.fields("/silent")).rejects.toMatchObject({ code: "topic_silent" });
  });

  it("reads little of a large file for a picture", async () => {
    const text = new TextEncoder().encode("{}");
    const topics = ["/bulk", "/camera"].map((name) => ({ name, schema: { name: "x", encoding: "", data: text }, messageEncoding: "json" }));
    const bulk = new Uint8Array(100_000);
    const picture = new TextEncoder().encode(JSON.stringify({ format: "png", data: btoa("\x89PNG\r\n") }));
    const messages = Array.from({ length: 200 }, (_, number) => ({ topic: number === 120 ? "/camera" : "/bulk", logTimeNs: timeOf(number), data: number === 120 ? picture : bulk }));
    const { ranges } = storeOf(await madeMcap(topics, messages, { chunkSize: 500_000 }));
    const session = new Session(await openRecording("mcap", ranges));
    const shown = await pictureAt(session, START);
    expect(shown?.logTimeNs).toBe(timeOf(120));
    expect(ranges.bytesRead).toBeLessThan(ranges.sizeBytes / 10);
  });
});
