import { mount } from "@vue/test-utils";
import { expect, it, vi } from "vitest";
import { effectScope, ref, shallowRef } from "vue";
import { useClock } from "../clock";
import { Previews } from "../previews";
import { Sources, type FileReader } from "../sources";
import { viewerKey, type Viewer } from "../viewer";
import { useAnnotations, type AnnotatedPicture } from "./useAnnotations";
import { openRecording } from "@/recordings/formats/open";
import type { MessageRequest, MessagesRequest } from "@/recordings/products/products";
import { Session } from "@/recordings/session";
import { madeMcap, storeOf } from "@/recordings/testing/recordings";

const SECOND = 1_000_000_000n;
const SPAN = { fromNs: 1_700_000_000n * SECOND, toNs: 1_700_000_060n * SECOND };
const ROW = { bbox: { center: { position: { x: 1, y: 1 } }, size_x: 1, size_y: 1 } };

/** A picture every second has detections 0.3 s later, from the third second on; those of the fifth picture are damaged. */
async function detections(): Promise<Session> {
  const text = (value: string): Uint8Array => new TextEncoder().encode(value);
  const messages = Array.from({ length: 10 }, (_, number) => {
    const stamp = { sec: Number(SPAN.fromNs / SECOND) + 3 + number, nanosec: 0 };
    const content = JSON.stringify({ header: { stamp }, detections: Array.from({ length: number + 1 }, () => ROW) });
    return { topic: "/boxes", logTimeNs: SPAN.fromNs + BigInt(3 + number) * SECOND + 300_000_000n, data: text(number === 2 ? "{" : content) };
  });
  const topics = [{ name: "/boxes", schema: { name: "vision_msgs/msg/Detection2DArray", encoding: "jsonschema", data: text("{}") }, messageEncoding: "json" }];
  return new Session(await openRecording("mcap", storeOf(await madeMcap(topics, messages)).ranges));
}

it("follows a picture: detections with its stamp, or the last ones before it, or none", async () => {
  const session = await detections();
  const quiet = { pause: () => Promise.resolve() };
  const reader = { message: (request: MessageRequest) => session.message(request), messages: (request: MessagesRequest) => session.messages(request, quiet) } as unknown as FileReader;
  const sources = new Sources([{ key: "k", name: "", files: [{ id: "f", path: "f", format: "mcap", size_bytes: 1, span: SPAN }] }], () => reader);
  const clock = effectScope().run(() => useClock(SPAN, [SPAN], SPAN.fromNs));
  if (clock === undefined) throw new Error("no clock");
  const viewer: Viewer = { clock, sources, previews: new Previews(() => Promise.resolve(null)), topics: [], locations: [], selected: ref(0) };
  const picture = shallowRef<AnnotatedPicture | null>(null);
  const topic = ref("/boxes");
  const results: ReturnType<typeof useAnnotations>[] = [];
  const setup = (): void => void results.push(useAnnotations(() => ({ recording: "k", topic: topic.value, fields: [] }), () => picture.value, () => 0));
  mount({ setup, template: "<i/>" }, { global: { provide: { [viewerKey as symbol]: viewer } } });
  const [read] = results;
  const show = (seconds: number, stampSeconds: number | null): void => {
    picture.value = { logTimeNs: SPAN.fromNs + BigInt(Math.round(seconds * 10)) * (SECOND / 10n), stampSeconds };
  };
  const count = (): number | undefined => read?.shown.value?.annotations.length;
  const start = Number(SPAN.fromNs / SECOND);

  show(7, start + 7);
  await vi.waitFor(() => expect(count()).toBe(5));
  show(8, null);
  await vi.waitFor(() => expect(read?.shown.value?.stampSeconds).toBe(start + 7));
  show(8.6, start + 8.6);
  await vi.waitFor(() => expect(count()).toBe(6));
  show(5.5, null);
  await vi.waitFor(() => expect(read?.failure.value?.code).toBe("message_damaged"));
  expect(read?.shown.value).toBeNull();
  show(4, start + 4);
  await vi.waitFor(() => expect(count()).toBe(2));
  show(1, start + 1);
  await vi.waitFor(() => expect(read?.shown.value).toBeNull());
  show(4, start + 4);
  await vi.waitFor(() => expect(count()).toBe(2));
  topic.value = "/other";
  await vi.waitFor(() => expect(read?.shown.value).toBeNull());
});
