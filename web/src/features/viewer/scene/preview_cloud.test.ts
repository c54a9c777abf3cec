import { mount } from "@vue/test-utils";
import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { ref, shallowRef } from "vue";
import type { MessageAtTime, ShownMessage } from "../useMessageAt";
import { Previews } from "../previews";
import { Sources } from "../sources";
import { viewerKey, type Viewer } from "../viewer";
import { DELAY_MS, usePreviewCloud } from "./usePreviewCloud";
import { ReadFailure } from "@/recordings/failures";
import type { PreviewFile } from "@/recordings/preview_file";

const SECOND = 1_000_000_000n;
const SERIES = { recording: "k", topic: "/lidar", fields: [] };

/** The previews of two files, each of 100 s, have clouds at these seconds. */
function viewerWith(seconds: Readonly<Record<string, readonly number[]>>) {
  const files = Object.keys(seconds).map((id, place) => ({ id, path: id, format: "mcap", size_bytes: 1, span: { fromNs: BigInt(100 * place) * SECOND, toNs: BigInt(100 * place + 99) * SECOND } }) as const);
  const timeNs = shallowRef(0n);
  const read: bigint[] = [];
  const previewOf = (id: string): Partial<PreviewFile> => ({
    cloudTimes: (topic) => (topic === "/lidar" ? (seconds[id] ?? []).map((second) => BigInt(second) * SECOND) : []),
    cloud: (_, at) => {
      read.push(at / SECOND);
      return Promise.resolve({ timeNs: at, frame: "lidar", totalPoints: 100, xyz: Float32Array.of(1, 2, Number(at / SECOND), 4, 5, NaN) });
    },
  });
  const viewer = {
    clock: { timeNs },
    sources: new Sources([{ key: "k", name: "", files }], () => { throw new Error("not needed"); }),
    previews: new Previews((id) => Promise.resolve(previewOf(id) as PreviewFile)),
  };
  const message = { shown: shallowRef<ShownMessage<"scene"> | null>(null), failure: shallowRef<ReadFailure | null>(null), isReading: ref(true), searchedToNs: shallowRef<bigint | null>(null) };
  const results: ReturnType<typeof usePreviewCloud>[] = [];
  const setup = () => void results.push(usePreviewCloud(() => SERIES, message as unknown as MessageAtTime<"scene">));
  mount({ setup, template: "<i/>" }, { global: { provide: { [viewerKey as symbol]: viewer as unknown as Viewer } } });
  const rough = () => results[0]?.value ?? null;
  const shown = () => {
    const cloud = rough();
    return cloud === null ? null : cloud.logTimeNs / SECOND;
  };
  const seek = (second: number) => (timeNs.value = BigInt(Math.round(second * 1e9)));
  const show = (second: number) => (message.shown.value = { logTimeNs: BigInt(second) * SECOND } as ShownMessage<"scene">);
  return { message, seek, show, shown, read, rough };
}

const wait = (ms = DELAY_MS) => vi.advanceTimersByTimeAsync(ms);
beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

it("shows the last cloud before the play head, with its finite points, until the message is there", async () => {
  const { message, seek, show, shown, rough } = viewerWith({ a: [5, 40], b: [150] });
  seek(60);
  await wait();
  expect(shown()).toBe(40n);
  const content = rough()?.scene.content;
  expect(content?.kind === "points" && [...content.points.positions]).toEqual([1, 2, 40]);
  expect(content?.kind === "points" && content.points.totalPoints).toBe(100);
  expect(rough()?.scene.frame).toBe("lidar");
  show(60);
  message.isReading.value = false;
  await wait(0);
  expect(shown()).toBeNull();
});

it("reads nothing of a preview where the message comes soon, nor while playing", async () => {
  const { message, seek, show, read, shown } = viewerWith({ a: [5] });
  seek(10);
  await wait(DELAY_MS - 1);
  show(10);
  await wait();
  seek(10.5);
  await wait();
  expect(shown()).toBeNull();
  message.isReading.value = false;
  await wait();
  expect(read).toEqual([]);
});

it("replaces a message of another time after a jump, and reads a cloud once", async () => {
  const { seek, show, shown, read } = viewerWith({ a: [5, 40], b: [150] });
  show(2);
  seek(2);
  await wait();
  expect(shown()).toBeNull();
  for (const [second, expected] of [[170, 150n], [171, 150n], [120, 40n], [6, 5n]] as const) {
    seek(second);
    await wait();
    expect(shown()).toBe(expected);
  }
  expect(read).toEqual([150n, 40n, 5n]);
  seek(3); // before the first cloud, and the message of 2 s is near
  await wait();
  expect(shown()).toBeNull();
});

it("stays where the messages cannot be read, and follows the play head", async () => {
  const { message, seek, shown } = viewerWith({ a: [5, 40] });
  message.failure.value = new ReadFailure("compression_unknown");
  message.isReading.value = false;
  seek(7);
  await wait();
  expect(shown()).toBe(5n);
  seek(50);
  await wait(0);
  expect(shown()).toBe(40n);
  seek(1);
  await wait(0);
  expect(shown()).toBeNull();
});
