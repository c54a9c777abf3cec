import { parse } from "@foxglove/rosmsg";
import { MessageWriter as Ros1Writer } from "@foxglove/rosmsg-serialization";
import { MessageWriter as Ros2Writer } from "@foxglove/rosmsg2-serialization";
import { describe, expect, it } from "vitest";
import type { Schema } from "../formats/recording";
import { decoderOf, type Value } from "./decoder";
import { fieldTree, numberAt, stepsOf, type FieldNode } from "./fields";

const ROS1 = `std_msgs/Header header
uint8 KIND=3
bool ok
int8 small
string name
float64[3] position
float32[] ranges
pkg/Point[] points
string[] names
duration took
int64 large
uint8[] data
================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================
MSG: pkg/Point
float32 x
uint16 y
`;
const ROS2 = ROS1.replace("uint32 seq\ntime stamp", "builtin_interfaces/Time stamp").replace("duration took", "builtin_interfaces/Duration took");

const MESSAGE = {
  ok: true,
  small: -5,
  name: "Zürich",
  position: [1.5, -2.25, 1e300],
  ranges: [0.5, Infinity],
  points: [{ x: 1, y: 65535 }, { x: -1, y: 0 }],
  names: ["", "b"],
  large: -(2n ** 40n),
  data: [1, 2, 255],
};
const PLAIN = { ...MESSAGE, position: Float64Array.from(MESSAGE.position), ranges: Float32Array.from(MESSAGE.ranges), ok: 1, large: -(2 ** 40), data: Uint8Array.from(MESSAGE.data), took: 2.5 };

function schema(encoding: string, messageEncoding: string, definition: string | Uint8Array, name = "pkg/Thing"): Schema {
  return { name, encoding, messageEncoding, definition: typeof definition === "string" ? new TextEncoder().encode(definition) : definition };
}

function leaves(nodes: FieldNode[]): string[] {
  return nodes.flatMap((node) => (node.path === null ? leaves(node.children) : [node.path]));
}

describe("ROS", () => {
  it("decodes ROS 1 as the reference writes it", () => {
    const header = { seq: 7, stamp: { sec: 4_000_000_000, nsec: 500_000_000 }, frame_id: "base" };
    const data = new Ros1Writer(parse(ROS1)).writeMessage({ ...MESSAGE, header, took: { sec: 2, nsec: 500_000_000 } });
    const value = decoderOf(schema("ros1msg", "ros1", ROS1))(data);
    expect(plain(value)).toEqual({ ...PLAIN, header: { seq: 7, stamp: 4_000_000_000.5, frame_id: "base" } });
  });

  it("decodes CDR as the reference writes it", () => {
    const header = { stamp: { sec: 17, nanosec: 250_000_000 }, frame_id: "odd" };
    // That writer counts letters where it should count bytes, so the name is plain.
    const message = { ...MESSAGE, name: "Zurich", header, took: { sec: 2, nanosec: 500_000_000 } };
    const data = new Ros2Writer(parse(ROS2, { ros2: true })).writeMessage(message);
    const value = decoderOf(schema("ros2msg", "cdr", ROS2))(data);
    expect(plain(value)).toEqual({ ...PLAIN, name: "Zurich", header: { stamp: 17.25, frame_id: "odd" } });
  });

  it("names the failure wherever a message is cut off", () => {
    const header = { stamp: { sec: 17, nanosec: 0 }, frame_id: "odd" };
    const data = new Ros2Writer(parse(ROS2, { ros2: true })).writeMessage({ ...MESSAGE, header, took: { sec: 2, nanosec: 0 } });
    const decode = decoderOf(schema("ros2msg", "cdr", ROS2));
    for (let length = 0; length < data.length; length++) {
      expect(() => decode(data.slice(0, length))).toThrow(/message_damaged/);
    }
  });

  it("does not make room for what a message only claims to hold", () => {
    const decode = decoderOf(schema("ros2msg", "cdr", "Empty[] many\n====\nMSG: pkg/Empty\n"));
    expect(() => decode(Uint8Array.of(0, 1, 0, 0, 255, 255, 255, 127))).toThrow(/message_damaged/);
    const nested = decoderOf(schema("ros1msg", "ros1", "int8 one\npkg/A[] a\n====\nMSG: pkg/A\npkg/B[] b\n====\nMSG: pkg/B\npkg/A[] a\n"));
    expect(() => nested(new Uint8Array(4001).map((_, at) => (at % 4 === 1 ? 1 : 0)))).toThrow(/too deep/);
  });

  it("says which encoding or definition it cannot read", () => {
    expect(() => decoderOf(schema("omgidl", "cdr", "struct A {};"))).toThrow("encoding_unknown: cdr, omgidl");
    expect(() => decoderOf(schema("ros2msg", "cdr", "pkg/Missing m\n"))).toThrow(/definition_unreadable.*pkg\/Missing/);
    expect(() => decoderOf(schema("ros2msg", "cdr", "no ( definition"))).toThrow("definition_unreadable");
    expect(() => decoderOf(schema("ros2msg", "cdr", "int8 a"))(Uint8Array.of(0, 7, 0, 0, 1))).toThrow("CDR 0x0007");
  });
});

describe("events of services", () => {
  const SERVICE = `int64 a
---
int64 sum
pkg/Note[] notes
================================================================================
MSG: pkg/Note
string text
`;
  const EVENT = `service_msgs/msg/ServiceEventInfo info
pkg/srv/Add_Request[] request
pkg/srv/Add_Response[] response
================================================================================
MSG: pkg/srv/Add_Request
int64 a
================================================================================
MSG: pkg/srv/Add_Response
int64 sum
pkg/Note[] notes
================================================================================
MSG: pkg/Note
string text
================================================================================
MSG: service_msgs/msg/ServiceEventInfo
uint8 event_type
builtin_interfaces/Time stamp
uint8[16] client_gid
int64 sequence_number
`;
  const info = { event_type: 1, stamp: { sec: 5, nanosec: 500_000_000 }, client_gid: new Uint8Array(16).fill(7), sequence_number: 3n };

  it("are decoded by the text of the service, as recorders write it", () => {
    const data = new Ros2Writer(parse(EVENT, { ros2: true })).writeMessage({ info, request: [{ a: 2n }], response: [{ sum: 5n, notes: [{ text: "ok" }] }] });
    const value = plain(decoderOf(schema("ros2msg", "cdr", SERVICE, "pkg/srv/Add_Event"))(data));
    expect(value).toMatchObject({ info: { event_type: 1, stamp: 5.5, sequence_number: 3 }, request: [{ a: 2 }], response: [{ sum: 5, notes: [{ text: "ok" }] }] });
  });

  it("may have a service without a request", () => {
    const text = EVENT.replace("MSG: pkg/srv/Add_Request\nint64 a", "MSG: pkg/srv/Add_Request\nuint8 structure_needs_at_least_one_member");
    const data = new Ros2Writer(parse(text, { ros2: true })).writeMessage({ info, request: [], response: [{ sum: 5n, notes: [] }] });
    const value = plain(decoderOf(schema("ros2msg", "cdr", SERVICE.replace("int64 a\n", ""), "pkg/srv/Add_Event"))(data));
    expect(value).toMatchObject({ request: [], response: [{ sum: 5 }] });
  });
});

describe("protobuf", () => {
  /** A record of protobuf: a number, or bytes with their length. */
  const record = (number: number, body: number | string | number[]): number[] => {
    if (typeof body === "number") return [number * 8, body];
    const bytes = typeof body === "string" ? [...new TextEncoder().encode(body)] : body;
    const length = bytes.length < 128 ? [bytes.length] : [(bytes.length & 127) | 128, bytes.length >> 7];
    return [number * 8 + 2, ...length, ...bytes];
  };
  const field = (name: string, number: number, type: number, typeName = ""): number[] =>
    record(2, [...record(1, name), ...record(3, number), ...record(4, 1), ...record(5, type), ...(typeName === "" ? [] : record(6, typeName))]);
  const file = (...parts: number[][]): number[] => record(1, [...parts.flat(), ...record(12, "proto3")]);

  it.each([
    ["Google's own files left out", ".google.protobuf.Timestamp", []],
    ["names that begin with no dot", "google.protobuf.Timestamp", []],
    [
      "Google's own files within",
      "google.protobuf.Timestamp",
      file(record(2, "google.protobuf"), record(4, [...record(1, "Timestamp"), ...field("seconds", 1, 3), ...field("nanos", 2, 5)])),
    ],
  ])("follows imports: %s", (_, typeName, imported) => {
    const inner = record(3, [...record(1, "Inner"), ...field("z", 1, 5)]);
    const own = record(4, [...record(1, "Log"), ...field("timestamp", 1, 11, typeName), ...field("inner", 2, 11, "Inner"), ...field("sibling", 3, 11, "b.Other"), ...inner]);
    const sibling = record(4, [...record(1, "Other"), ...field("n", 1, 5)]);
    const descriptors = Uint8Array.from([...imported, ...file(record(2, "a.b"), own, sibling)]);
    const data = Uint8Array.from([...record(1, [...record(1, 100), ...record(2, 7)]), ...record(2, record(1, 4)), ...record(3, record(1, 9))]);
    expect(plain(decoderOf(schema("protobuf", "protobuf", descriptors, "a.b.Log"))(data))).toEqual({
      timestamp: { seconds: 100, nanos: 7 }, inner: { z: 4 }, sibling: { n: 9 },
    });
  });

  it("passes over fields that it does not know, groups as well", () => {
    const descriptors = Uint8Array.from(file(record(4, [...record(1, "M"), ...field("a", 1, 5)])));
    const data = Uint8Array.from([9 * 8 + 3, ...record(1, 5), 9 * 8 + 4, ...record(1, 3)]);
    expect(plain(decoderOf(schema("protobuf", "protobuf", descriptors, "M"))(data))).toEqual({ a: 3 });
  });

  // package t; message M { double a = 1; repeated sint32 b = 2; N n = 3; bytes c = 4; string d = 5;
  //   message N { float x = 1; int64 y = 2; optional int32 z = 3; } }  (proto3, as protobuf's own library writes it)
  const DESCRIPTORS =
    "CoMBCgF0EgF0InMKAU0SCQoBYRgBIAEoARIJCgFiGAIgAygREhEKAW4YAyABKAsyBi50Lk0uThIJCgFjGAQgASgMEgkKAWQYBSABKAkaLwoBThIJCgF4GAEgASgCEgkKAXkYAiABKAMSDgoBehgDIAEoBUgAiAEBQgQKAl96YgZwcm90bzM=";
  const set = Uint8Array.from(atob(DESCRIPTORS), (letter) => letter.charCodeAt(0));

  it("decodes numbers, packed lists, messages and what is left out", () => {
    const decode = decoderOf(schema("protobuf", "protobuf", set, "t.M"));
    const data = Uint8Array.of(0x09, 0, 0, 0, 0, 0, 0, 0xf8, 0x3f, 0x12, 3, 1, 2, 3, 0x1a, 2, 0x10, 5, 0x22, 2, 9, 8);
    expect(plain(decode(data))).toEqual({ a: 1.5, b: [-1, 1, -2], n: { x: 0, y: 5 }, c: Uint8Array.of(9, 8), d: "" });
    expect(() => decode(data.slice(0, 5))).toThrow(/message_damaged/);
    expect(() => decoderOf(schema("protobuf", "protobuf", set, "t.Missing"))).toThrow(/definition_unreadable/);
  });
});

describe("fields", () => {
  const value: Value = { pose: { x: 1, name: "a", ok: true }, list: Float64Array.of(4, 5), "odd.key": { "a\"b": 3 }, none: [] };

  it("offers what is a number, by a name that finds it again", () => {
    const paths = leaves(fieldTree(value));
    expect(paths).toEqual(["pose.x", "pose.ok", "list[0]", "list[1]", '["odd.key"]["a\\"b"]']);
    expect(paths.map((path) => numberAt(value, stepsOf(path) ?? []))).toEqual([1, 1, 4, 5, 3]);
  });

  it("offers only the first of many elements, and says how many more there are", () => {
    const [node] = fieldTree({ ranges: new Float32Array(1000) });
    expect(node?.children).toHaveLength(16);
    expect(node?.hidden).toBe(984);
  });

  it("finds nothing where there is nothing", () => {
    for (const path of ["pose.missing", "pose.name", "list[9]", "pose", "__proto__.x", "pose.constructor"]) {
      expect(numberAt(value, stepsOf(path) ?? [])).toBeNull();
    }
    expect(stepsOf("a..b")).toBeNull();
    expect(stepsOf("")).toBeNull();
  });
});

/** The same without what is odd about the objects (they have no prototype). */
function plain(value: Value): unknown {
  if (ArrayBuffer.isView(value)) return value;
  if (Array.isArray(value)) return value.map(plain);
  if (typeof value !== "object" || value === null) return value;
  return Object.fromEntries(Object.entries(value).map(([name, inner]) => [name, plain(inner)]));
}
