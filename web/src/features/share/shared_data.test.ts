import { expect, it } from "vitest";
import { filesOutside, withTopicsOf } from "./shared_data";
import type { Topic } from "@/api/types";
import type { ViewerData } from "@/features/viewer/queries";

const topic = (name: string, count: number | null, first_ns: number | null) => ({ name, message_type: "sensor_msgs/msg/Imu", count, first_ns }) as Topic;
const fileOf = (id: string) => ({ id, path: `${id}.mcap`, format: "mcap" as const, size_bytes: 1, span: { fromNs: 0n, toNs: 1n } });
const ofWhole = { recording: "w", name: "/whole", messageType: null, count: 1, firstNs: 0, density: [1] };
const data: ViewerData = {
  recordings: [{ key: "w", name: "whole", files: [fileOf("a")] }, { key: "half", name: "half", files: [fileOf("b"), fileOf("c")] }],
  topics: [ofWhole],
};

it("finds the files of recordings that a link shares in part", () => {
  const files = [{ id: "a", recording_id: "1" }, { id: "b", recording_id: "2" }, { id: "c", recording_id: null }];
  expect(filesOutside(files, [{ id: "1" }])).toEqual(files.slice(1));
});

it("shows each topic of the shared files of a recording once", () => {
  const { topics } = withTopicsOf(data, new Map([["b", [topic("/imu", 5, 20), topic("/odd", null, null)]], ["c", [topic("/imu", 7, 10), topic("/odd", 1, 30)]], ["foreign", [topic("/no", 1, 1)]]]));
  const common = { recording: "half", messageType: "sensor_msgs/msg/Imu", density: [] };
  expect(topics).toEqual([ofWhole, { ...common, name: "/imu", count: 12, firstNs: 10 }, { ...common, name: "/odd", count: null, firstNs: 30 }]);
});
