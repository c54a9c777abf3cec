// The logic behind the page of a mission: the tree, the axis, the topics, the commands.
import { expect, it } from "vitest";
import { barsPath, COLUMNS, fileAt, firstFiles, firstPlace, lanesOf, matching, MAX_LANES, silences, sorted } from "./timeline";
import type { MissionTopic, TimelineFile } from "./queries";
import { rowsOf, treeOf, withBranches } from "./tree";
import type { Mission, Recording } from "@/api/types";
import { missionCommands } from "@/components/commands";

const S = 1e9;

function file(path: string, from: number | null = null, to: number | null = null, more: Partial<TimelineFile> = {}): TimelineFile {
  const [start_ns, end_ns] = [from === null ? null : from * S, to === null ? null : to * S];
  return { id: `id of ${path}`, path, recording_id: null, start_ns, end_ns, size_bytes: 10, content: "indexed", state: "verified", is_derived: false, ...more };
}

const bag = { id: "r", name: "drive", file_ids: ["1", "2"], content: "recovered" } as unknown as Recording;

it("makes folders of paths, and one recording of a folder that holds just its files", () => {
  const files = [
    file("a.bag", 0, 5), file("drive/drive_0.db3", 1, 4, { recording_id: "r" }), file("drive/metadata.yaml", null, null, { recording_id: "r" }),
    file("x/y/z.txt"),
  ];
  const tree = treeOf(files, [bag]);
  expect(tree.map((node) => [node.kind, node.name])).toEqual([["recording", "drive"], ["folder", "x"], ["file", "a.bag"]]);
  expect(tree[0]).toMatchObject({ fileCount: 2, sizeBytes: 20, startNs: 1 * S, endNs: 4 * S, content: "recovered" });
  const shown = rowsOf(tree, new Set(["folder x/"]));
  expect(shown.map(({ node, depth }) => `${depth} ${node.name}`)).toEqual(["0 drive", "1 drive_0.db3", "1 metadata.yaml", "0 x", "0 a.bag"]);
});

it("chooses all files of a folder with it, and the folder with all of its files", () => {
  const tree = treeOf([file("f/a"), file("f/b"), file("c")], []);
  const rows = rowsOf(tree, new Set(["folder f/"]));
  const whole = withBranches(new Set(), new Set(["folder f/"]), rows);
  expect([...whole].sort()).toEqual(["folder f/", "id of f/a", "id of f/b"]);
  const open = rowsOf(tree, new Set());
  const less = withBranches(whole, new Set([...whole].filter((key) => key !== "id of f/a")), open);
  expect([...less]).toEqual(["id of f/b"]);
  expect(withBranches(less, new Set([...less, "id of f/a"]), open).has("folder f/")).toBe(true);
});

it("puts files that overlap above each other, and finds where nothing was recorded", () => {
  const axis = { startNs: 0, endNs: 100 * S };
  const { lanes, gaps, maxSimultaneous, coveredNs, without } = lanesOf(
    [file("b", 5, 20), file("a", 0, 10), file("c", 20, 30), file("d", 60, 100), file("e"), file("f", -900, -800)], axis,
  );
  expect(lanes.map((lane) => lane.map((item) => item.file.path))).toEqual([["a", "c", "d"], ["b"]]);
  expect(gaps).toEqual([{ startNs: 30 * S, endNs: 60 * S }]);
  expect([maxSimultaneous, coveredNs / S, without]).toEqual([2, 70, 2]);
});

it("does not take more room for ten thousand files at once", () => {
  const many = Array.from({ length: 10_000 }, (_, at) => file(String(at), at, at + 5000));
  const axis = { startNs: 0, endNs: 15_000 * S };
  const { lanes, maxSimultaneous } = lanesOf(many, axis);
  expect(lanes.length).toBe(MAX_LANES);
  expect(maxSimultaneous).toBe(5000);
  for (const lane of lanes) expect(barsPath(lane, axis, () => true).length).toBeLessThan(40 * COLUMNS);
});

it("draws bars where files are, and finds them again there", () => {
  const axis = { startNs: 0, endNs: 100 * S };
  const { lanes } = lanesOf([file("a", 0, 50), file("b", 75, 100, { content: "broken" })], axis);
  const lane = lanes[0] ?? [];
  expect(barsPath(lane, axis, () => true)).toBe("M0 0H800V1H0ZM1200 0H1600V1H1200Z");
  expect(barsPath(lane, axis, ({ content }) => content === "broken")).toBe("M1200 0H1600V1H1200Z");
  expect(fileAt(lane, 60 * S, 1 * S)).toBeNull();
  expect(fileAt(lane, 74.5 * S, 1 * S)?.file.path).toBe("b");
});

function topic(name: string, more: Partial<MissionTopic> = {}): MissionTopic {
  return {
    name, message_type: "T", other_types: [], count: 1, file_count: 1, recording_count: 1, recordings: [[0, 0]], first_ns: 0, last_ns: 1,
    rate_hz: 1, longest_gap_ns: 0, stored_bytes: 1, counts: [1], ...more,
  };
}

it("counts the silences between the first and the last message alone", () => {
  expect(silences([0, 1, 0, 0, 1, 0, 1, 0])).toEqual({ count: 2, share: 0.5 });
  expect(silences([0, 0])).toEqual({ count: 0, share: 0 });
});

it("finds and orders topics", () => {
  const all = [topic("/a", { count: 5 }), topic("/IMU", { count: null }), topic("/c", { count: 9, message_type: "sensor_msgs/Imu" })];
  expect(matching(all, "imu").map(({ name }) => name)).toEqual(["/IMU", "/c"]);
  expect(sorted(all, "-count").map(({ name }) => name)).toEqual(["/c", "/a", "/IMU"]);
  expect(sorted(all, "-name").map(({ name }) => name)).toEqual(["/c", "/IMU", "/a"]);
});

it("leads from a topic to the first file that has times", () => {
  const files = firstFiles([file("late", 9, 10, { recording_id: "r" }), file("early", 1, 2, { recording_id: "r" }), file("y.yaml", null, null, { recording_id: "r" })]);
  const topics = { axis: null, recordings: [{ id: "r", name: "drive" }], items: [], isCurrent: true };
  expect(firstPlace(topic("/a"), topics, files)).toMatchObject({ params: { fileId: "id of early" }, query: { topic: "/a" } });
  expect(firstPlace(topic("/a", { recordings: [] }), topics, files)).toBeNull();
});

it("writes commands that a shell and Python take literally", () => {
  const mission = { id: "m", name: "it's; rm -rf", project: { id: "p", name: "Alps" } } as unknown as Mission;
  expect(missionCommands(mission, []).cli).toBe("klein download -p Alps -m 'it'\\''s; rm -rf'");
  expect(missionCommands(mission, [file("a b.bag"), file("x[1].bag")]).cli).toBe("klein download 'a b.bag' id of x[1].bag -p Alps -m 'it'\\''s; rm -rf'");
  expect(missionCommands({ ...mission, name: "*" }, []).cli).toBe("klein download -m m");
});
