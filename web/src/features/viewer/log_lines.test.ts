import { expect, it } from "vitest";
import { isLogType, linesOf, matchingLines, placeAt, roughLines, withRough, type Line } from "./log_lines";

it.each([
  ["rosgraph_msgs/Log", { level: 4, name: "/driver", msg: "late" }, ["warning", "/driver", "late"]],
  ["rcl_interfaces/msg/Log", { level: 40, name: "driver", msg: "lost" }, ["error", "driver", "lost"]],
  ["foxglove.Log", { level: 5, name: "driver", message: "gone" }, ["fatal", "driver", "gone"]],
  ["foxglove.Log", { level: "DEBUG", name: "driver", message: "fine" }, ["debug", "driver", "fine"]],
  ["std_msgs/msg/String", { data: "hello" }, ["info", "", "hello"]],
  ["rosgraph_msgs/Log", { level: 3 }, ["info", "", ""]],
])("reads a line of %s", (type, value, expected) => {
  expect(isLogType(type)).toBe(true);
  const [line] = linesOf(type, 7n, value);
  expect([line?.level, line?.source, line?.text]).toEqual(expected);
  expect(line?.timeNs).toBe(7n);
});

it("reads one line for each component of diagnostics", () => {
  const status = [{ level: 0, name: "motor", message: "OK" }, { level: 2, name: "lidar", message: "no data" }];
  expect(linesOf("diagnostic_msgs/msg/DiagnosticArray", 1n, { status }).map(({ level, source }) => [level, source])).toEqual([["info", "motor"], ["error", "lidar"]]);
});

it("reads no line of other types or broken values", () => {
  expect(linesOf("sensor_msgs/Imu", 1n, { level: 4 })).toEqual([]);
  expect(linesOf("diagnostic_msgs/DiagnosticArray", 1n, { status: 5 })).toEqual([]);
  expect(linesOf("std_msgs/String", 1n, null)).toEqual([]);
});

const lines: Line[] = (["info", "error", "warning"] as const).map((level, at) => ({ timeNs: BigInt(at * 10), level, source: "Node", text: `Text ${at}` }));

it("filters by level and text", () => {
  expect(matchingLines(lines, "warning", "").map(({ text }) => text)).toEqual(["Text 1", "Text 2"]);
  expect(matchingLines(lines, "debug", " node TEXT 2 ").map(({ text }) => text)).toEqual(["Text 2"]);
});

it("knows the line of a time", () => {
  expect([-1n, 0n, 15n, 99n].map((timeNs) => placeAt(lines, timeNs))).toEqual([-1, 0, 1, 2]);
});

it("shows lines of the preview where nothing was read", () => {
  const rough = roughLines([5n, 15n, 25n].map((timeNs) => ({ timeNs, severity: timeNs === 5n ? "unknown" : "error", source: "", text: `rough ${timeNs}` })));
  expect(rough.map(({ level }) => level)).toEqual(["info", "error", "error"]);
  const textsOf = (span: { fromNs: bigint; toNs: bigint } | null): string[] => withRough(lines, span, rough).map(({ text }) => text);
  expect(textsOf({ fromNs: 0n, toNs: 20n })).toEqual(["Text 0", "Text 1", "Text 2", "rough 25"]);
  expect(textsOf({ fromNs: 10n, toNs: 20n })).toEqual(["Text 0", "rough 5", "Text 1", "Text 2", "rough 25"]);
  expect(textsOf(null)).toEqual(["Text 0", "rough 5", "Text 1", "rough 15", "Text 2", "rough 25"]);
});
