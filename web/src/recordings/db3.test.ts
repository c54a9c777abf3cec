import { describe, expect, it, vi } from "vitest";
import { ReadFailure } from "./failures";
import type { Damage, Message, Order, Recording } from "./formats/recording";
import { openRecording } from "./formats/open";
import { Session } from "./session";
import { madeDb3, PAGE, type TestRow } from "./testing/database";
import { storeOf } from "./testing/recordings";

const TOPICS = [
  { id: 1, name: "/small", type: "std_msgs/msg/String" },
  { id: 2, name: "/large", type: "sensor_msgs/msg/Image" },
];
// Every seventh message is large; times are not in the order of the rows.
const ROWS: readonly TestRow[] = Array.from({ length: 400 }, (_, at) => ({
  topicId: at % 7 === 0 ? 2 : 1,
  timeNs: 1_700_000_000_000_000_000n + BigInt((at ^ 3) * 1000),
  data: Uint8Array.from({ length: at % 7 === 0 ? 3000 + at : 20 + (at % 40) }, (_unused, byte) => (byte * 31 + at) & 255),
}));
const ALL = { fromNs: 0n, toNs: 2n ** 62n };

/** Time and content of each message of a topic, as texts, which are quick to compare. */
function expected(topicId: number, order: Order = "forward"): string[] {
  const inOrder = ROWS.filter((row) => row.topicId === topicId).toSorted((a, b) => (a.timeNs < b.timeNs ? -1 : 1));
  return (order === "forward" ? inOrder : inOrder.reverse()).map(({ timeNs, data }) => textOf(timeNs, data));
}

function textOf(timeNs: bigint, data: Uint8Array): string {
  return `${timeNs} ${Buffer.from(data).toString("base64")}`;
}

async function read(recording: Recording, topic: string, span = ALL, order: Order = "forward"): Promise<{ messages: Message[]; damage: Damage[] }> {
  const [messages, damage]: [Message[], Damage[]] = [[], []];
  for await (const message of recording.messages([topic], span, order, (part) => damage.push(part))) messages.push(message);
  return { messages, damage };
}

function textsOf(messages: readonly Message[]): string[] {
  return messages.map(({ logTimeNs, data }) => textOf(logTimeNs, data));
}

describe("a rosbag2 database", () => {
  it.each([true, false])("has its messages by time, with and without an index of times (%s)", async (hasIndex) => {
    const recording = await openRecording("db3", storeOf(madeDb3(TOPICS, ROWS, { hasIndex })).ranges);
    expect(recording.span).toEqual({ fromNs: ROWS[3]?.timeNs, toNs: ROWS[396]?.timeNs });
    expect(recording.indexedUntil === null).toBe(hasIndex);
    expect(recording.topics.map(({ name }) => name)).toEqual(["/small", "/large"]);
    for (const [topic, id] of [["/small", 1], ["/large", 2]] as const) {
      for (const order of ["forward", "backward"] as const) {
        expect(textsOf((await read(recording, topic, ALL, order)).messages)).toEqual(expected(id, order));
      }
    }
  });

  it("reads a span, whose ends belong to it, and little beside", async () => {
    const { ranges } = storeOf(madeDb3(TOPICS, ROWS));
    const recording = await openRecording("db3", ranges);
    const times = ROWS.filter(({ topicId }) => topicId === 1).map(({ timeNs }) => timeNs).toSorted();
    const { messages } = await read(recording, "/small", { fromNs: times[100] ?? 0n, toNs: times[120] ?? 0n });
    expect(textsOf(messages)).toEqual(expected(1).slice(100, 121));
    const pieces = recording.pieces(["/small"], ALL);
    expect(pieces.length).toBeGreaterThan(4);
    const inPieces = [];
    for (const piece of pieces) inPieces.push(...(await recording.readPiece(piece, ["/small"])));
    expect(textsOf(inPieces)).toEqual(expected(1));
  });

  it("decodes common types without a definition, and others by theirs", async () => {
    const text = (value: string): Uint8Array => Uint8Array.from([0, 1, 0, 0, value.length + 1, 0, 0, 0, ...new TextEncoder().encode(value), 0]);
    const range = (fields: number): Uint8Array => Uint8Array.from([0, 1, 0, 0, ...new Uint8Array(8), 1, 0, 0, 0, 0, 0, 0, 0, ...new Uint8Array(4 * fields)]);
    const topics = [...TOPICS, { id: 3, name: "/own", type: "own_msgs/msg/Own" }, { id: 4, name: "/range", type: "sensor_msgs/msg/Range" }, { id: 5, name: "/other", type: "own_msgs/msg/Other" }];
    const rows = [[1, text("hello")], [3, Uint8Array.from([0, 1, 0, 0, 7])], [4, range(4)], [4, range(5)], [5, range(1)]] as const;
    const file = madeDb3(topics, rows.map(([topicId, data], at) => ({ topicId, timeNs: BigInt(at), data })), { definitions: { "own_msgs/msg/Own": "uint8 value" } });
    const session = new Session(await openRecording("db3", storeOf(file).ranges));
    expect((await session.fields("/own")).fields.map(({ path }) => path)).toEqual(["value"]);
    // Jazzy has one field more than Humble.
    const curves = await session.curves({ topic: "/range", fields: ["max_range"], fromNs: 0n, toNs: 9n, maxBytes: 1e6 }, { pause: () => Promise.resolve(), onCurves: () => undefined });
    expect([curves.messages, curves.damaged]).toEqual([2, []]);
    await expect(session.fields("/other")).rejects.toMatchObject({ code: "definition_missing", detail: "own_msgs/msg/Other" });
  });

  it("ends a page of messages where its bytes were read", async () => {
    const { ranges } = storeOf(madeDb3(TOPICS, ROWS));
    const recording = await openRecording("db3", ranges);
    const session = new Session(recording);
    // As if the index had one part only, and each message were on pages of its own.
    vi.spyOn(recording, "pieces").mockReturnValue([]);
    let bytesRead = 0;
    Object.defineProperty(ranges, "bytesRead", { get: () => (bytesRead += 100) });
    const times: bigint[] = [];
    let pages = 0;
    for (let fromNs = 0n; fromNs <= ALL.toNs; pages += 1) {
      const request = { topic: "/small", product: "time", fromNs, toNs: ALL.toNs, maxMessages: 1_000, maxBytes: 1_000 } as const;
      const { messages, untilNs } = await session.messages(request, { pause: () => Promise.resolve() });
      times.push(...messages.map(({ logTimeNs }) => logTimeNs));
      fromNs = untilNs + 1n;
    }
    expect(times.map(String)).toEqual(expected(1).map((text) => text.split(" ")[0]));
    expect(pages).toBeGreaterThan(20);
  });

  it("shows what can be read of a damaged one", async () => {
    const file = madeDb3(TOPICS, ROWS);
    const leaves = Array.from({ length: file.length / PAGE }, (_, page) => page * PAGE).filter((at) => file[at] === 13);
    const torn = file.slice();
    torn.fill(255, leaves[leaves.length >> 1], (leaves[leaves.length >> 1] ?? 0) + PAGE);
    const { messages, damage } = await read(await openRecording("db3", storeOf(torn).ranges), "/small");
    expect(messages.length).toBeGreaterThan(0);
    expect(messages.length).toBeLessThan(expected(1).length);
    expect(damage.length).toBeGreaterThan(0);
  });

  it("ends for pages that lead to themselves, and for any other bytes", async () => {
    const whole = madeDb3(TOPICS, ROWS);
    for (let seed = 1; seed <= 100; seed += 1) {
      const bytes = whole.slice();
      for (let change = 0; change < 8; change += 1) {
        const random = Math.imul(seed * 8 + change + 1, 2_654_435_761) >>> 0;
        bytes[random % bytes.length] = random >>> 24;
      }
      try {
        await read(await openRecording("db3", storeOf(bytes).ranges), "/large");
      } catch (thrown) {
        expect(thrown).toBeInstanceOf(ReadFailure);
      }
    }
    await expect(openRecording("db3", storeOf(new Uint8Array(200)).ranges)).rejects.toMatchObject({ code: "not_readable_here" });
  });
});
