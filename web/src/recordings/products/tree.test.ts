import { parse } from "@foxglove/rosmsg";
import { MessageWriter } from "@foxglove/rosmsg2-serialization";
import { expect, it } from "vitest";
import { decoderOf, type Value } from "../decoding/decoder";
import type { Message, Schema } from "../formats/recording";
import { plainValue } from "./plain_value";
import { messageTree, type TreeNode } from "./tree";

const DEFINITION = `pkg/Inner inner
float32 ratio
float64[3] fixed
uint8[] bytes
bool flag
string text
================================================================================
MSG: pkg/Inner
int32 count
`;

function messageOf(schema: Schema, data: Uint8Array): Message {
  const channel = { topic: "/t", schema, properties: [] };
  return { logTimeNs: 5n, publishTimeNs: 5n, sequence: 1, channel, data, chunkSpan: { fromNs: 0n, toNs: 9n } };
}

const ros2: Schema = { name: "pkg/msg/Thing", encoding: "ros2msg", messageEncoding: "cdr", definition: new TextEncoder().encode(DEFINITION) };
const json: Schema = { name: "Words", encoding: "jsonschema", messageEncoding: "json", definition: new Uint8Array() };

function treeOf(schema: Schema, data: Uint8Array) {
  return messageTree(messageOf(schema, data), () => decoderOf(schema)(data));
}

const flat = (nodes: readonly TreeNode[], prefix = ""): string[] =>
  nodes.flatMap(({ label, type, text, children }) => [`${prefix}${label}: ${type}${text === null ? "" : ` = ${text}`}`, ...flat(children, `${prefix}  `)]);

it("shows the fields of a ROS message with the types of its definition", () => {
  const value = { inner: { count: -7 }, ratio: 0.1, fixed: [1, 2.5, Number.NaN], bytes: [1, 255], flag: true, text: "a\nb" };
  const { messageType, nodes, undecoded } = treeOf(ros2, new MessageWriter(parse(DEFINITION, { ros2: true })).writeMessage(value));
  expect([messageType, undecoded]).toEqual(["pkg/msg/Thing", null]);
  expect(flat(nodes)).toEqual([
    "inner: pkg/Inner", "  count: int32 = -7", "ratio: float32 = 0.1", "fixed: float64[3]", "  [0]: float64 = 1", "  [1]: float64 = 2.5", "  [2]: float64 = NaN",
    "bytes: uint8[]", "  [0]: uint8 = 1", "  [1]: uint8 = 255", "flag: bool = 1", "text: string = a\nb",
  ]);
});

it("shows the types of JSON by its values", () => {
  const data = new TextEncoder().encode(JSON.stringify({ n: 1.5, deep: [{ m: null, b: false }] }));
  expect(flat(treeOf(json, data).nodes)).toEqual(["n: number = 1.5", "deep: [1]", "  [0]: ", "    m: null = null", "    b: bool = false"]);
});

it("shows the first bytes of what cannot be decoded, and why", () => {
  const { nodes, undecoded } = treeOf(json, new Uint8Array(5000).fill(0xab));
  expect(nodes).toEqual([]);
  expect([undecoded?.code, undecoded?.hex.startsWith("ab ab"), undecoded?.hex.split(/\s/).length]).toEqual(["message_damaged", true, 1024]);
});

it("has a bounded size, and says what is hidden", () => {
  const rows = Array.from({ length: 500 }, () => Array.from({ length: 500 }, () => 1));
  const { nodes } = messageTree(messageOf(json, new Uint8Array()), () => ({ rows }));
  const count = (all: readonly TreeNode[]): number => all.reduce((sum, { children }) => sum + 1 + count(children), 0);
  expect(count(nodes)).toBeLessThanOrEqual(4000);
  expect(nodes[0]?.hidden).toBeGreaterThan(400);
});

it("ends a value that nests without end", () => {
  let deep: Value = 1;
  for (let level = 0; level < 5000; level += 1) deep = [deep];
  expect(() => messageTree(messageOf(json, new Uint8Array()), () => deep)).not.toThrow();
  expect(() => plainValue(deep)).not.toThrow();
});

it("makes plain values of bounded size", () => {
  expect(plainValue({ name: "x", level: 3, list: new Float32Array([1, 2]), none: null })).toEqual({ name: "x", level: 3, list: [1, 2], none: null });
  expect((plainValue("x".repeat(10_000)) as string).length).toBe(4000);
  expect((plainValue(new Float64Array(1e6)) as number[]).length).toBeLessThan(2001);
  expect(Object.getPrototypeOf(plainValue({ ["__proto__"]: 1, x: 2 }))).toBe(Object.prototype);
});
