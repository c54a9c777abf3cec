import { mount } from "@vue/test-utils";
import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { effectScope, ref } from "vue";
import { useClock } from "../clock";
import ImagePanel from "../panels/ImagePanel.vue";
import { Previews } from "../previews";
import type { ViewerTopic } from "../queries";
import { Sources, type FileReader } from "../sources";
import { viewerKey, type Viewer } from "../viewer";
import { pictureValues } from "@/recordings/pictures/values";
import type { MessageRequest } from "@/recordings/products/products";

const SPAN = { fromNs: 0n, toNs: 10n };
const META = { publishTimeNs: 5n, logTimeNs: 5n, sequence: 0, sizeBytes: 1 };
const drawn = vi.fn();

beforeEach(() => {
  const context = new Proxy({}, { get: (_, name) => (name === "putImageData" ? drawn : () => ({ width: 8 })), set: () => true });
  vi.spyOn(HTMLCanvasElement.prototype, "getContext").mockReturnValue(context as unknown as null);
});
afterEach(() => vi.unstubAllGlobals());

it("computes the colours of a picture once, although it is drawn again with its annotations", async () => {
  const coloured = vi.fn();
  vi.stubGlobal("ImageData", class { constructor(readonly data: Uint8ClampedArray) { coloured(); } });
  const picture = { image: pictureValues(2, 1, Float32Array.of(1, 2), "m"), width: 2, height: 1, encoding: "32FC1", stampSeconds: 5 };
  const annotations = { annotations: [], omittedPoints: 0, stampSeconds: 5 };
  let showAnnotations = (): void => undefined;
  const beforeAnnotations = new Promise<void>((resolve) => (showAnnotations = resolve));
  const reader = {
    message: ({ product }: MessageRequest) => Promise.resolve({ message: { ...META, product: product === "picture" ? picture : annotations }, searchedToNs: null, damaged: [] }),
    messages: () => beforeAnnotations.then(() => ({ messages: [{ ...META, product: annotations }], untilNs: 10n, damaged: [] })),
  } as unknown as FileReader;
  const sources = new Sources([{ key: "k", name: "", files: [{ id: "f", path: "f", format: "mcap", size_bytes: 1, span: SPAN }] }], () => reader);
  const clock = effectScope().run(() => useClock(SPAN, [SPAN], 5n));
  if (clock === undefined) throw new Error("no clock");
  const topics = [{ recording: "k", name: "/camera/boxes", messageType: "vision_msgs/msg/Detection2DArray", count: 1 } as unknown as ViewerTopic];
  const viewer: Viewer = { clock, sources, previews: new Previews(() => Promise.resolve(null)), topics, locations: [], selected: ref(0) };
  const panel = { kind: "image", isWide: false, series: [{ recording: "k", topic: "/camera/depth", fields: [] }] };
  const shown = mount(ImagePanel, { props: { panel, priority: 0 }, global: { provide: { [viewerKey as symbol]: viewer } } });
  await vi.waitFor(() => expect(drawn).toHaveBeenCalledTimes(1));
  showAnnotations();
  await vi.waitFor(() => expect(shown.get("[data-image]").attributes("data-annotations")).toBe("5"));
  await vi.waitFor(() => expect(drawn).toHaveBeenCalledTimes(2));
  expect(coloured).toHaveBeenCalledTimes(1);
  await shown.setProps({ panel: { ...panel, series: [{ recording: "k", topic: "/camera/depth", fields: ["map=grey"] }] } });
  await vi.waitFor(() => expect(coloured).toHaveBeenCalledTimes(2));
  shown.unmount();
});
