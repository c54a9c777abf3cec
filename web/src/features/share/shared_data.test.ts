import { VueQueryPlugin } from "@tanstack/vue-query";
import { expect, it, vi } from "vitest";
import { createApp, effectScope } from "vue";
import { filesOutside, useTopicsOfFiles, withTopicsOf } from "./shared_data";
import { createQueries } from "@/api/queries";
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

/** Returns what is loaded of the topics of so many files. */
function loadTopics(count: number, fetchTopics: (id: string) => Promise<Topic[]>) {
  const files = Array.from({ length: count }, (_, number) => `file ${number}`);
  const app = createApp({}).use(VueQueryPlugin, { queryClient: createQueries() });
  const loaded = app.runWithContext(() => effectScope().run(() => useTopicsOfFiles("m", () => files, fetchTopics)));
  if (loaded === undefined) throw new Error("the scope has ended");
  return loaded;
}

it("loads the topics of however many files, some at a time", async () => {
  let [running, most] = [0, 0];
  const { topics, isComplete, error } = loadTopics(450, async (id) => {
    most = Math.max(most, (running += 1));
    await Promise.resolve();
    running -= 1;
    return [topic(`/of ${id}`, 1, 1)];
  });
  expect(isComplete()).toBe(false);
  await vi.waitUntil(isComplete, { timeout: 10_000 });
  expect(topics.value?.size).toBe(450);
  expect(topics.value?.get("file 449")?.map(({ name }) => name)).toEqual(["/of file 449"]);
  expect([most, error.value]).toEqual([100, null]);
});

it("keeps the topics that have arrived where later ones fail, and does not try for ever", async () => {
  const fetchTopics = vi.fn((id: string) => (id === "file 150" ? Promise.reject(new Error("gone")) : Promise.resolve([topic("/imu", 1, 1)])));
  const { topics, isComplete, error } = loadTopics(250, fetchTopics);
  await vi.waitUntil(() => error.value !== null, { timeout: 10_000 });
  await new Promise((resolve) => setTimeout(resolve, 50));
  expect(fetchTopics).toHaveBeenCalledTimes(200);
  expect([topics.value?.size, isComplete()]).toEqual([100, false]);
});
