import { expect, it } from "vitest";
import type { ViewerData } from "./queries";
import type { SourceFile } from "./sources";
import { groupAt, timeGroups } from "./time_groups";

const SECOND = 1_000_000_000n;
const DAY = 86_400n * SECOND;
const NOW = 20_000n * DAY;

const file = (id: string, fromNs: bigint): SourceFile => ({ id, path: `${id}.mcap`, format: "mcap", size_bytes: 1, span: { fromNs, toNs: fromNs + 60n * SECOND } });
const topic = (recording: string, count: number | null, first: bigint) => ({ recording, name: `/${recording}`, messageType: "std_msgs/String", count, firstNs: Number(first), density: [1, 2] });
const recording = (key: string, ...files: SourceFile[]) => ({ key, name: key, files });

const BOOT: ViewerData = { recordings: [recording("boot", file("a", 5n * SECOND))], topics: [topic("boot", 10, 5n * SECOND)] };
const DRIVE: ViewerData = {
  recordings: [recording("drive", file("b", NOW), file("c", NOW + 100n * SECOND)), recording("evening", file("d", NOW + DAY / 2n))],
  topics: [topic("drive", 500, NOW), topic("evening", 20, NOW + DAY / 2n)],
};
const BOTH: ViewerData = { recordings: [...BOOT.recordings, ...DRIVE.recordings], topics: [...BOOT.topics, ...DRIVE.topics] };

it("keeps what was recorded within a day on one axis", () => {
  const groups = timeGroups(DRIVE);
  expect(groups).toHaveLength(1);
  expect(groups[0]).toMatchObject({ ...DRIVE, span: { fromNs: NOW, toNs: NOW + DAY / 2n + 60n * SECOND } });
  expect(groups[0]?.recorded).toHaveLength(3);
  expect(timeGroups({ recordings: [], topics: [] })).toEqual([]);
});

it("gives a recording of another clock an axis of its own", () => {
  const [boot, drive] = timeGroups(BOTH);
  expect(boot?.span).toEqual({ fromNs: 5n * SECOND, toNs: 65n * SECOND });
  expect(drive?.span.fromNs).toBe(NOW);
  expect(boot?.topics.map(({ name, density }) => [name, density])).toEqual([["/boot", []]]);
  expect(boot?.recordings.map(({ key, files }) => [key, files.length])).toEqual([["boot", 1], ["drive", 0], ["evening", 0]]);
  expect(drive?.recordings.map(({ key, files }) => [key, files.length])).toEqual([["boot", 0], ["drive", 2], ["evening", 1]]);
});

it("forgets first messages that are in another group", () => {
  const twice: ViewerData = { recordings: [recording("x", file("a", 5n * SECOND), file("b", NOW))], topics: [topic("x", 3, 5n * SECOND)] };
  expect(timeGroups(twice).map(({ topics }) => topics[0]?.firstNs)).toEqual([5e9, null]);
});

it("shows the group of the time in the address", () => {
  const groups = timeGroups(BOTH);
  expect(groupAt(groups, 10n * SECOND, groups[1])).toBe(groups[0]);
  expect(groupAt(groups, NOW + SECOND, groups[0])).toBe(groups[1]);
});

it("shows the current group at other times, and at first that with the most messages", () => {
  const groups = timeGroups(BOTH);
  expect(groupAt(groups, 10n * DAY, groups[0])).toBe(groups[0]);
  expect(groupAt(groups, null, null)).toBe(groups[1]);
  expect(groupAt(groups, 10n * DAY, timeGroups(BOTH)[0])).toBe(groups[1]);
  const uncounted = timeGroups({ ...BOTH, topics: BOTH.topics.map((one) => ({ ...one, count: null })) });
  expect(groupAt(uncounted, null, undefined)).toBe(uncounted[1]);
  expect(groupAt([], null, null)).toBeNull();
});
