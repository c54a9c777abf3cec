import { parse } from "@foxglove/rosmsg";
import { MessageWriter as Ros1Writer } from "@foxglove/rosmsg-serialization";
import { MessageWriter as Ros2Writer } from "@foxglove/rosmsg2-serialization";
import { expect, it } from "vitest";
import { CurveReading } from "./curve_reading";
import { openRecording } from "../formats/open";
import type { Message } from "../formats/recording";
import { MAX_DAMAGED } from "../limits";
import type { CurvesRequest } from "../protocol";
import { Session } from "../session";
import { madeBag, madeMcap, storeOf } from "../testing/recordings";

const START = 1_700_000_000_000_000_001n;
const STEP_NS = 10_000_000n;
const COUNT = 400;
/** Headers are stamped before the message is recorded, and not evenly. */
const LATENCY_NS = (number: number): bigint => 3_000_000n + BigInt((number * 37) % 1_000);
const logTime = (number: number): bigint => START + BigInt(number) * STEP_NS;
const stampNs = (number: number): bigint => logTime(number) - LATENCY_NS(number);
const x = (number: number): number => (number * number) / 7;
const partsOf = (timeNs: bigint, nanoseconds: string) => ({ sec: Number(timeNs / 1_000_000_000n), [nanoseconds]: Number(timeNs % 1_000_000_000n) });

const ROS1 = "Header header\nfloat64 x\n================\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";
const ROS2 = "# A comment\nstd_msgs/Header header\nfloat64 x\n================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n";

function bag(): Promise<Uint8Array> {
  const writer = new Ros1Writer(parse(ROS1));
  const messages = Array.from({ length: COUNT }, (_, number) => ({ connection: 0, timeNs: logTime(number), data: writer.writeMessage({ header: { seq: number, stamp: partsOf(stampNs(number), "nsec"), frame_id: "f" }, x: x(number) }) }));
  return Promise.resolve(madeBag([{ topic: "/t", type: "pkg/Stamped", definition: ROS1 }], [messages.slice(0, 100), messages.slice(100)]));
}

function mcap(encoding: "cdr" | "json", stamp: (number: number) => bigint = stampNs): Promise<Uint8Array> {
  const text = new TextEncoder();
  const writer = new Ros2Writer(parse(ROS2, { ros2: true }));
  const json = (number: number): Uint8Array => text.encode(JSON.stringify({ timestamp: partsOf(stamp(number), "nsec"), x: x(number) }));
  const cdr = (number: number): Uint8Array => writer.writeMessage({ header: { stamp: partsOf(stamp(number), "nanosec"), frame_id: "f" }, x: x(number) });
  const schema = encoding === "cdr" ? { name: "pkg/msg/Stamped", encoding: "ros2msg", data: text.encode(ROS2) } : { name: "Stamped", encoding: "jsonschema", data: text.encode("{}") };
  const messages = Array.from({ length: COUNT }, (_, number) => ({ topic: "/t", logTimeNs: logTime(number), data: encoding === "cdr" ? cdr(number) : json(number) }));
  return madeMcap([{ name: "/t", schema, messageEncoding: encoding }], messages, { chunkSize: 2_000 });
}

async function curves(format: "mcap" | "rosbag1", bytes: Uint8Array, more: Partial<CurvesRequest> = {}) {
  const session = new Session(await openRecording(format, storeOf(bytes).ranges));
  const request = { topic: "/t", fields: ["x", "derivative(x)"], fromNs: logTime(0), toNs: logTime(COUNT), maxBytes: Infinity, ...more };
  return session.curves(request, { pause: () => Promise.resolve(), onCurves: () => undefined });
}

function derivative(number: number, timeOf: (number: number) => bigint): number {
  return (x(number) - x(number - 1)) / (Number(timeOf(number) - timeOf(number - 1)) / 1e9);
}

const MADE = [["a bag", "rosbag1", bag], ["CDR", "mcap", () => mcap("cdr")], ["JSON", "mcap", () => mcap("json")]] as const;

it.each(MADE)("has the stamps of %s to the nanosecond", async (_, format, made) => {
  const { seconds, values, unstamped } = await curves(format, await made(), { time: "header" });
  expect(unstamped).toBe(0);
  expect(seconds).toEqual(Array.from({ length: COUNT }, (__, number) => Number(stampNs(number) - START) / 1e9));
  expect(values[1]?.slice(1)).toEqual(Array.from({ length: COUNT - 1 }, (__, number) => derivative(number + 1, stampNs)));
});

it.each(MADE)("has log times by default: %s", async (_, format, made) => {
  const { seconds, values, unstamped } = await curves(format, await made());
  expect(unstamped).toBe(0);
  expect(seconds[5]).toBe(Number(5n * STEP_NS) / 1e9);
  expect(values[1]?.[5]).toBe(derivative(5, logTime));
});

it("begins the derivative of a later part with the message before it", async () => {
  const { seconds, values } = await curves("mcap", await mcap("cdr"), { fromNs: logTime(200), toNs: logTime(210) });
  expect(seconds).toHaveLength(11);
  expect(values[1]?.[0]).toBe(derivative(200, logTime));
});

it.each([["missing", () => 0n], ["of another clock", (number: number) => logTime(number) - START + 5n]])("uses log times where stamps are %s, and counts them", async (_, stamp) => {
  const { seconds, unstamped } = await curves("mcap", await mcap("cdr", stamp), { time: "header" });
  expect(unstamped).toBe(COUNT);
  expect(seconds[7]).toBe(Number(7n * STEP_NS) / 1e9);
});

/** Returns the derivatives of x = 3 t at the seconds 0 to 9, of which some parts are damaged. All are known at first. */
function derivatives(damaged: readonly (readonly [fromSeconds: number, toSeconds: number])[]): (number | null | undefined)[] {
  const span = { fromNs: 0n, toNs: 9_000_000_000n };
  const reading = new CurveReading({ fields: ["derivative(x)"], time: "log" }, span, span);
  for (const [fromSeconds, toSeconds] of damaged) reading.breakAt({ fromSeconds, toSeconds });
  for (let second = 0; second < 10; second += 1) reading.add({ logTimeNs: BigInt(second) * 1_000_000_000n } as Message, { x: 3 * second });
  const { seconds, values } = reading.curves();
  return Array.from({ length: 10 }, (_, second) => values[0]?.[seconds.indexOf(second)]);
}

it("has no derivative over damaged parts, but before, between and behind them", () => {
  expect(derivatives([])).toEqual([null, 3, 3, 3, 3, 3, 3, 3, 3, 3]);
  expect(derivatives([[2.2, 2.8], [6.1, 7.9]])).toEqual([null, 3, 3, null, 3, 3, 3, null, null, 3]);
  const many = Array.from({ length: 2 * MAX_DAMAGED }, (_, part) => [5.1 + part / 1_000, 5.101 + part / 1_000] as const);
  expect(derivatives([...many, [7.1, 7.2]])).toEqual([null, 3, 3, 3, 3, 3, null, null, null, 3]); // the last ones are joined
});
