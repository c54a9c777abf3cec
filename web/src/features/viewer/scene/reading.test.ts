import { flushPromises, mount } from "@vue/test-utils";
import { expect, it } from "vitest";
import { ref, shallowRef, type ShallowRef } from "vue";
import { MAX_PAGES } from "./pages";
import { markerObject } from "./marker_objects";
import { useSceneTopic } from "./useSceneTopic";
import { useTransforms } from "./useTransforms";
import type { ViewerTopic } from "../queries";
import { Sources, type FileReader, type SourceFile } from "../sources";
import { viewerKey, type Viewer } from "../viewer";
import { ReadFailure } from "@/recordings/failures";
import type { Marker, MarkerChange } from "@/recordings/geometry/markers";
import { IDENTITY } from "@/recordings/geometry/poses";
import type { MessageRequest, MessagesRequest } from "@/recordings/products/products";

const SECOND = 1_000_000_000n;
const SPAN = { fromNs: 0n, toNs: 100n * SECOND };
const FILE: SourceFile = { id: "a", path: "a.mcap", format: "mcap", size_bytes: 1, span: SPAN };
const points = { positions: new Float32Array(6), origin: [0, 0, 0], colours: null, totalPoints: 2 } as const;
const MARKER: Marker = { key: "", frame: "map", stampSeconds: null, shape: "cube", pose: IDENTITY, scale: [1, 1, 1], colour: [1, 1, 1, 1], lifetimeSeconds: Infinity, isFrameLocked: false, points, text: "" };

/** A recording whose topics have a product at each of these times. A page has `pageSize` messages. */
function recordingOf(topics: Readonly<Record<string, ReadonlyMap<bigint, unknown>>>, pageSize: number) {
  const state = { requests: 0, refused: "" };
  const read = (logTimeNs: bigint, product: unknown) => ({ logTimeNs, publishTimeNs: logTimeNs, sequence: 0, sizeBytes: 1, product });
  const reader = {
    message: ({ topic, atNs }: MessageRequest) => {
      const last = [...(topics[topic] ?? [])].findLast(([timeNs]) => timeNs <= atNs);
      return Promise.resolve({ message: last === undefined ? null : read(...last), searchedToNs: null, damaged: [] });
    },
    messages: ({ topic, fromNs, toNs }: MessagesRequest) => {
      state.requests += 1;
      if (topic === state.refused) return Promise.reject(new ReadFailure("link_refused"));
      const all = [...(topics[topic] ?? [])].filter(([timeNs]) => timeNs >= fromNs && timeNs <= toNs).map((entry) => read(...entry));
      const untilNs = all.length > pageSize ? all[pageSize - 1]?.logTimeNs : toNs;
      return Promise.resolve({ messages: all.slice(0, pageSize), untilNs, damaged: [] });
    },
    close: () => undefined,
  } as unknown as FileReader;
  return { sources: new Sources([{ key: "k", name: "", files: [FILE] }], () => reader), state };
}

async function within<Result>(sources: Sources, names: Readonly<Record<string, string>>, atNs: bigint, use: () => Result) {
  const timeNs = shallowRef(atNs);
  const topics = Object.entries(names).map(([name, messageType]): ViewerTopic => ({ recording: "k", name, messageType, count: 1, firstNs: 0, density: [] }));
  const clock = { span: SPAN, timeNs, wait: () => () => undefined };
  let result: Result | undefined;
  mount({ setup: () => void (result = use()), template: "<i/>" }, { global: { provide: { [viewerKey as symbol]: { clock, sources, topics } as unknown as Viewer } } });
  await flushPromises();
  return { timeNs: timeNs as ShallowRef<bigint>, result: result as Result };
}

/** A message each second from 10 s on, which sets a marker of its own and deletes the one before. */
function markers(): ReadonlyMap<bigint, unknown> {
  const times = Array.from({ length: 40 }, (_, place) => place + 10);
  return new Map(times.map((seconds) => {
    const changes: MarkerChange[] = [{ action: "delete", key: String(seconds - 1) }, { action: "set", marker: { ...MARKER, key: String(seconds) } }];
    return [BigInt(seconds) * SECOND, { frame: "map", stampSeconds: null, content: { kind: "markers", changes } }];
  }));
}

const scene = () => useSceneTopic(() => ({ recording: "k", topic: "/markers", fields: [] }), () => 0, () => 0);

it.each([["several pages", 4], ["more pages than are read", 2]])("shows the markers of now after a jump over %s", async (_, pageSize) => {
  const { sources, state } = recordingOf({ "/markers": markers() }, pageSize);
  const { result } = await within(sources, {}, 30n * SECOND, scene);
  expect(result.markers.value.map(({ key }) => key)).toEqual(["30"]);
  expect(state.requests).toBeLessThanOrEqual(MAX_PAGES);
});

it("shows no markers of the future before the first message", async () => {
  const { sources } = recordingOf({ "/markers": markers() }, 100);
  const { result, timeNs } = await within(sources, {}, 30n * SECOND, scene);
  timeNs.value = 5n * SECOND;
  await flushPromises();
  expect(result.markers.value).toEqual([]);
  timeNs.value = 11n * SECOND;
  await flushPromises();
  expect(result.markers.value.map(({ key }) => key)).toEqual(["11"]);
});

/** A transform each 0.1 s, whose x is its time in seconds. */
function transforms(child: string): ReadonlyMap<bigint, unknown> {
  return new Map(Array.from({ length: 1_000 }, (_, place) => {
    const pose = { ...IDENTITY, position: [place / 10, 0, 0] };
    return [BigInt(place) * (SECOND / 10n), [{ parent: "map", child, stampSeconds: place / 10, pose }]];
  }));
}

const DYNAMIC = { "/tf": "tf2_msgs/msg/TFMessage" };

it.each([["of several pages", 6], ["that are too many to read around it", 1]])("has the transform of the play head among transforms %s", async (_, pageSize) => {
  const { sources } = recordingOf({ "/tf": transforms("base") }, pageSize);
  const { result, timeNs } = await within(sources, DYNAMIC, 20n * SECOND, () => useTransforms(() => 0, ref(false)));
  expect(result.buffer.find("map", "base", 20)).toMatchObject({ pose: { position: [20, 0, 0] } });
  for (const tenths of [201n, 203n, 206n, 500n]) {
    timeNs.value = tenths * (SECOND / 10n);
    await flushPromises();
    expect(result.buffer.find("map", "base", Number(tenths) / 10)).toMatchObject({ pose: { position: [Number(tenths) / 10, 0, 0] }, isExtrapolated: false });
  }
});

it("reads static transforms again where that failed", async () => {
  const { sources, state } = recordingOf({ "/tf_static": transforms("lidar"), "/tf": transforms("base") }, 2_000);
  state.refused = "/tf_static";
  const { result, timeNs } = await within(sources, { ...DYNAMIC, "/tf_static": "tf2_msgs/msg/TFMessage" }, 20n * SECOND, () => useTransforms(() => 0, ref(false)));
  expect(result.failure.value?.code).toBe("link_refused");
  state.refused = "";
  timeNs.value = 21n * SECOND;
  await flushPromises();
  expect(result.failure.value).toBeNull();
  expect(result.buffer.frames).toEqual(["base", "lidar", "map"]);
});

it("frees the copies of a list of cubes", () => {
  const { object, dispose } = markerObject({ ...MARKER, shape: "cube_list" });
  let isFreed = false;
  (object as { addEventListener: (type: string, act: () => void) => void }).addEventListener("dispose", () => (isFreed = true));
  dispose();
  expect(isFreed).toBe(true);
});
