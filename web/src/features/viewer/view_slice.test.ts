import { expect, it } from "vitest";
import type { Panel } from "./layout";
import type { ViewerTopic } from "./queries";
import { viewSlice } from "./view_slice";

const file = (id: string, fromNs: bigint, toNs: bigint) => ({ id, path: `${id}.mcap`, format: "mcap" as const, size_bytes: 1, span: { fromNs, toNs } });
const RECORDINGS = [
  { key: "split", name: "split", files: [file("a", 0n, 9n), file("b", 10n, 19n)] },
  { key: "other", name: "other.mcap", files: [file("c", 0n, 19n)] },
  { key: "silent", name: "silent.mcap", files: [file("d", 0n, 19n)] },
];
const topic = (recording: string, name: string, messageType: string | null = null): ViewerTopic => ({ recording, name, messageType, count: 1, firstNs: 0, density: [] });
const TOPICS = [
  topic("split", "/imu"), topic("split", "/odom"), topic("split", "/tf", "tf2_msgs/msg/TFMessage"),
  topic("other", "/imu"), topic("silent", "/imu"), topic("silent", "/tf", "tf2_msgs/msg/TFMessage"),
];
const series = (recording: string, name: string) => ({ recording, topic: name, fields: [] });
const PANELS: Panel[] = [
  { kind: "plot", isWide: false, series: [series("split", "/imu"), series("other", "/imu")] },
  { kind: "raw", isWide: false, series: [series("split", "/imu"), series("split", "/gone")] },
];

it("has the shown topics and the transforms of the recordings that are shown, as far as the range goes", () => {
  const slice = viewSlice(PANELS, TOPICS, RECORDINGS, { fromNs: 12n, toNs: 15n });
  expect(slice).toMatchObject({ topics: ["/imu", "/tf"], recordings: ["split", "other.mcap"], startNs: 12n, endNs: 16n });
  expect(slice.files.map((one) => [one.file.id, one.topics])).toEqual([["b", ["/imu", "/tf"]], ["c", ["/imu"]]]);
});

it("has all of the time without a range", () => {
  const slice = viewSlice(PANELS, TOPICS, RECORDINGS, null);
  expect([slice.startNs, slice.endNs, slice.files.length]).toEqual([null, null, 3]);
});

it("is empty without panels", () => {
  expect(viewSlice([], TOPICS, RECORDINGS, null)).toMatchObject({ topics: [], recordings: [], files: [] });
});
