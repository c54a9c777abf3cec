import { flushPromises, mount } from "@vue/test-utils";
import { expect, it } from "vitest";
import { effectScope, ref } from "vue";
import { useClock } from "./clock";
import MapSeries from "./MapSeries.vue";
import { Previews } from "./previews";
import { Sources, type FileReader } from "./sources";
import { viewerKey, type Viewer } from "./viewer";
import type { Value } from "@/recordings/decoding/decoder";
import { locationOf } from "@/recordings/products/location";
import type { MessagesRequest } from "@/recordings/products/products";

const SPAN = { fromNs: 0n, toNs: 100n };
const FENCE = JSON.stringify({ type: "LineString", coordinates: [[8.5, 47.3], [8.6, 47.4]] });
const NOWHERE = JSON.stringify({ type: "FeatureCollection", features: [] });

/** Returns the legend of a topic whose messages are all the same, and how often a track was asked for. */
async function legendOf(messageType: string, value: Value) {
  const message = { logTimeNs: 0n, publishTimeNs: 0n, sequence: 0, sizeBytes: 1, product: locationOf(value) };
  let tracks = 0;
  const reader = {
    message: () => Promise.resolve({ message, searchedToNs: null, damaged: [] }),
    messages: ({ toNs }: MessagesRequest) => {
      tracks += 1;
      return Promise.resolve({ messages: [message], untilNs: toNs, damaged: [] });
    },
    close: () => undefined,
  } as unknown as FileReader;
  const file = { id: "f", path: "f.mcap", format: "mcap", size_bytes: 1, span: SPAN } as const;
  const clock = effectScope().run(() => useClock(SPAN, [SPAN], 0n));
  if (clock === undefined) throw new Error("no clock");
  const viewer: Viewer = {
    clock,
    sources: new Sources([{ key: "k", name: "", files: [file] }], () => reader),
    previews: new Previews(() => Promise.resolve(null)),
    topics: [{ recording: "k", name: "/t", messageType, count: 1, firstNs: 0, density: [] }],
    locations: [],
    selected: ref(0),
  };
  const props = { series: { recording: "k", topic: "/t", fields: [] }, priority: 0, colour: 1, canRemove: false };
  const wrapper = mount(MapSeries, { props, global: { provide: { [viewerKey as symbol]: viewer } } });
  await flushPromises();
  return { shown: wrapper.get("[data-position]").text(), missing: wrapper.find("[data-missing-text]").exists(), tracks };
}

it("counts messages of a receiver that have no position", async () => {
  expect(await legendOf("sensor_msgs/msg/NavSatFix", { latitude: 47, longitude: 8, status: { status: -1 } })).toEqual({ shown: "No position", missing: true, tracks: 1 });
});

it("shows shapes of GeoJSON without a word about positions, and reads no track of them", async () => {
  expect(await legendOf("foxglove.GeoJSON", { geojson: FENCE })).toEqual({ shown: "1 shape", missing: false, tracks: 0 });
  expect((await legendOf("foxglove.GeoJSON", { geojson: NOWHERE })).shown).toBe("0 shapes");
});
