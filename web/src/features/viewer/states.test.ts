import { describe, expect, it } from "vitest";
import { barsOf, changeFrom, colourOf, durationNs, EMPTY_RUNS, MAX_RUNS, offeredFields, runAt, runsOf, shownFields, stateText, withStates } from "./state_runs";
import type { Schema } from "@/recordings/formats/recording";
import { fieldTypes } from "@/recordings/products/field_types";
import type { ReadMessage } from "@/recordings/products/products";
import { statesOf, type State } from "@/recordings/products/states";

function message(timeNs: number, value: State): ReadMessage<"states"> {
  return { logTimeNs: BigInt(timeNs), publishTimeNs: 0n, sequence: 0, sizeBytes: 0, product: { mode: value } };
}

const MODES = [message(0, "idle"), message(10, "idle"), message(20, "drive"), message(30, "drive"), message(50, "idle"), message(60, "idle")];
const runs = runsOf([{ fileId: "f", fromNs: 0n, toNs: 100n, content: withStates(EMPTY_RUNS, MODES) }], "mode");

function schemaOf(definition: string, name = "pkg/msg/Type"): Schema {
  return { name, encoding: "ros2msg", messageEncoding: "cdr", definition: new TextEncoder().encode(definition) };
}

describe("a state timeline", () => {
  it("joins equal values to runs, which last until the next value", () => {
    expect(runs.map(({ value, fromNs, toNs }) => [value, fromNs, toNs])).toEqual([["idle", 0n, 10n], ["drive", 20n, 30n], ["idle", 50n, 60n]]);
    expect(runs.map((run) => durationNs(runs, run))).toEqual([20n, 30n, 10n]);
    expect(runAt(runs, 49n)?.value).toBe("drive");
    expect(runAt(runs, -1n)).toBeNull();
    expect(runAt(runs, 49n, [{ fromNs: 45n, toNs: 48n }])).toBeNull();
    expect(runAt(runs, 49n, [{ fromNs: 50n, toNs: 60n }])?.value).toBe("drive");
  });

  it("goes from change to change", () => {
    expect([changeFrom(runs, 0n, "next"), changeFrom(runs, 49n, "next"), changeFrom(runs, 50n, "next")]).toEqual([20n, 50n, null]);
    expect([changeFrom(runs, 60n, "previous"), changeFrom(runs, 50n, "previous"), changeFrom(runs, 0n, "previous")]).toEqual([50n, 20n, null]);
  });

  it("draws bars over the time window, and none over what was not read", () => {
    expect(barsOf(runs, { fromNs: 0n, toNs: 100n }, 1_000).map(({ from, to, run }) => [from, to, run?.value])).toEqual([[0, 0.2, "idle"], [0.2, 0.5, "drive"], [0.5, 0.6, "idle"]]);
    expect(barsOf(runs, { fromNs: 0n, toNs: 100n }, 1_000, [{ fromNs: 35n, toNs: 45n }])[1]?.to).toBe(0.3);
    expect(barsOf(runs, { fromNs: 30n, toNs: 40n }, 1_000).map(({ from, to }) => [from, to])).toEqual([[0, 1]]);
  });

  it("joins values that are too close to be drawn", () => {
    const many = Array.from({ length: 1_000 }, (_, number) => message(number, number % 2));
    const dense = runsOf([{ fileId: "f", fromNs: 0n, toNs: 999n, content: withStates(EMPTY_RUNS, many) }], "mode");
    const bars = barsOf(dense, { fromNs: 0n, toNs: 999n }, 100);
    expect(bars.length).toBeLessThanOrEqual(100);
    expect(bars.every(({ run }) => run === null)).toBe(true);
  });

  it("stays small however often a value changes", () => {
    let content = EMPTY_RUNS;
    for (let page = 0; page < 20; page += 1) content = withStates(content, Array.from({ length: 1_000 }, (_, number) => message(page * 1_000 + number, number)));
    expect(content.messages).toBe(20_000);
    const own = content.byField.get("mode") ?? [];
    expect(own.length).toBeLessThanOrEqual(MAX_RUNS);
    expect([own[0]?.fromNs, own.at(-1)?.toNs, own[0]?.isMixed]).toEqual([0n, 19_999n, true]);
  });

  it("continues a run over adjoining parts", () => {
    const part = (fromNs: number, toNs: number) => ({ fileId: "f", fromNs: BigInt(fromNs), toNs: BigInt(toNs), content: withStates(EMPTY_RUNS, [message(fromNs, "idle"), message(toNs, "idle")]) });
    expect(runsOf([part(0, 9), part(10, 19), part(30, 39)], "mode").map(({ fromNs, toNs }) => [fromNs, toNs])).toEqual([[0n, 19n], [30n, 39n]]);
  });

  it("gives false no colour and other values one each", () => {
    const flags = runsOf([{ fileId: "f", fromNs: 0n, toNs: 9n, content: withStates(EMPTY_RUNS, [message(0, false), message(1, true)]) }], "mode");
    expect([...colourOf(flags)]).toEqual([[false, 0], [true, 2]]);
  });
});

describe("discrete fields", () => {
  it("are texts, truth values and small whole numbers", () => {
    const value = { mode: "drive", on: true, level: 3, share: 0.5, large: 1e9, joints: [{ state: 2 }], ranges: new Float32Array([1, 2]) };
    expect(statesOf(value)).toEqual({ mode: "drive", on: true, level: 3, "joints[0].state": 2, "ranges[0]": 1, "ranges[1]": 2 });
    expect(Object.keys(statesOf({ many: Array.from({ length: 1_000 }, () => ({ a: 1, b: 2 })), text: "x".repeat(1_000) })).length).toBeLessThanOrEqual(200);
    expect(statesOf({ text: "x".repeat(1_000) }).text).toHaveLength(200);
  });

  it("exclude floating point numbers by the definition, and prefer fields with named values", () => {
    const types = fieldTypes(schemaOf("float32 share\nuint8 count\nuint8 OFF=0\nuint8 ON=1\nuint8 state\n"));
    const first = { share: 1, count: 7, state: 1 };
    expect(offeredFields(first, types)).toEqual(["count", "state"]);
    expect(shownFields(["count", "state"], [], first, types)).toEqual(["state"]);
    expect(shownFields(["count", "state"], ["count"], first, types)).toEqual(["count"]);
    expect(stateText(types, "state", 1)).toBe("ON (1)");
    expect(stateText(types, "state", 9)).toBe("9");
  });
});

describe("names of constants", () => {
  it("belong to the next field of their type, as in NavSatStatus", () => {
    const types = fieldTypes(schemaOf("int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 status\nuint16 SERVICE_GPS=1\nuint16 service\n"));
    expect(types?.status?.names).toEqual({ "-1": "STATUS_NO_FIX", 0: "STATUS_FIX" });
    expect(types?.service?.names).toEqual({ 1: "SERVICE_GPS" });
  });

  it("belong to the field whose name they begin with, as in BatteryState", () => {
    const types = fieldTypes(schemaOf("uint8 POWER_SUPPLY_STATUS_FULL=4\nuint8 POWER_SUPPLY_HEALTH_COLD=6\nfloat32 voltage\nuint8 power_supply_status\nuint8 power_supply_health\n"));
    expect(types?.power_supply_status?.names).toEqual({ 4: "POWER_SUPPLY_STATUS_FULL" });
    expect(types?.power_supply_health?.names).toEqual({ 6: "POWER_SUPPLY_HEALTH_COLD" });
  });

  it("belong to the field before them where none follows, as in GoalStatus", () => {
    expect(fieldTypes(schemaOf("uint8 status\nuint8 PENDING=0\nuint8 ACTIVE=1\nstring text\n"))?.status?.names).toEqual({ 0: "PENDING", 1: "ACTIVE" });
  });

  it("are those of fields inside of others and of arrays", () => {
    const types = fieldTypes(schemaOf(`pkg/Part[] parts\n${"=".repeat(80)}\nMSG: pkg/Part\nuint8 A=1\nuint8 kind\n`));
    expect(types?.["parts[].kind"]).toEqual({ type: "uint8", names: { 1: "A" } });
    expect(stateText(types, "parts[3].kind", 1)).toBe("A (1)");
  });

  it("are not known without a ROS definition, and end in a type that contains itself", () => {
    expect(fieldTypes({ ...schemaOf("{}"), messageEncoding: "json", encoding: "jsonschema" })).toBeNull();
    const types = fieldTypes(schemaOf(`pkg/Node[] nodes\n${"=".repeat(80)}\nMSG: pkg/Node\nuint8 a\npkg/Node[] nodes\n`));
    expect(Object.keys(types ?? {}).length).toBeLessThanOrEqual(2_000);
  });
});
