import { flushPromises, mount } from "@vue/test-utils";
import { expect, it } from "vitest";
import { effectScope, nextTick, ref } from "vue";
import { useClock } from "./clock";
import { Sources, type FileReader } from "./sources";
import { useCurves } from "./useCurves";
import { useMessages } from "./useMessages";
import { useParts } from "./useParts";
import { viewerKey, type Viewer } from "./viewer";
import { ReadFailure } from "@/recordings/failures";
import type { MessagesRequest } from "@/recordings/products/products";
import type { CurvesRequest } from "@/recordings/protocol";

const SECOND = 1_000_000_000n;
const SPAN = { fromNs: 0n, toNs: 600n * SECOND };
const series = { recording: "k", topic: "/t", fields: ["x"] };
/** Something that never ends would make more requests. */
const MOST_REQUESTS = 100;

interface Made {
  readonly stepNs: bigint;
  /** How much of the time one request for curves reads. */
  readonly curvesNs?: bigint;
}

/** A viewer of one file with a message in every step of time. */
function viewerAt(startNs: bigint, { stepNs, curvesNs = SECOND }: Made) {
  const requests: { readonly fromNs: bigint; readonly toNs: bigint }[] = [];
  const note = (request: { fromNs: bigint; toNs: bigint }): void => {
    if (requests.push({ fromNs: request.fromNs, toNs: request.toNs }) > MOST_REQUESTS) throw new ReadFailure("too_large");
  };
  const opened = { span: SPAN, indexedUntil: null, topics: [] };
  const reader = {
    open: () => Promise.resolve(opened),
    message: () => Promise.reject(new Error("not needed")),
    messages: async (request: MessagesRequest) => {
      await Promise.resolve();
      note(request);
      const first = request.fromNs <= 0n ? 0n : ((request.fromNs + stepNs - 1n) / stepNs) * stepNs;
      const times = Array.from({ length: request.maxMessages }, (_, at) => first + BigInt(at) * stepNs).filter((timeNs) => timeNs <= request.toNs);
      const messages = times.map((logTimeNs) => ({ logTimeNs, publishTimeNs: logTimeNs, sequence: 0, sizeBytes: 1, product: null }));
      return { messages, untilNs: times.length < request.maxMessages ? request.toNs : (times.at(-1) ?? request.toNs), damaged: [] };
    },
    request: async (kind: string, request: CurvesRequest) => {
      await Promise.resolve();
      if (kind === "fields") return { fields: [{ path: "x", name: "x", isNumber: true, children: [] }] };
      note(request);
      const untilNs = request.fromNs + curvesNs < request.toNs ? request.fromNs + curvesNs : request.toNs;
      return { seconds: [], values: [[]], messages: 0, isWhole: true, damaged: [], wholeBytes: 2 ** 30, untilNs };
    },
    close: () => undefined,
  } as unknown as FileReader;
  const file = { id: "f", path: "f.mcap", format: "mcap", size_bytes: 1, span: SPAN } as const;
  const sources = new Sources([{ key: "k", name: "", files: [file] }], () => reader);
  const clock = effectScope().run(() => useClock(SPAN, [SPAN], startNs));
  if (clock === undefined) throw new Error("no clock");
  const viewer: Viewer = { clock, sources, topics: [], selected: ref(0) };
  /** Runs a composable in the viewer. */
  function using<Result>(setup: () => Result): Result {
    const results: Result[] = [];
    mount({ setup: () => void results.push(setup()), template: "<i/>" }, { global: { provide: { [viewerKey as symbol]: viewer } } });
    return results[0] as Result;
  }
  return { clock, requests, using };
}

async function settled(): Promise<void> {
  await nextTick();
  await flushPromises();
}

it("comes to a time that has many messages before it, from ever nearer", async () => {
  const { using, requests } = viewerAt(300n * SECOND, { stepNs: 1_000_000n });
  const { read, failure, messages } = using(() => useMessages(() => series, "plain", () => 0));
  await settled();
  expect(failure.value).toBeNull();
  expect(read.value?.fromNs).toBe(300n * SECOND - SECOND / 2n);
  expect(messages.value.findLast(({ logTimeNs }) => logTimeNs <= 300n * SECOND)?.logTimeNs).toBe(300n * SECOND);
  expect(requests.length).toBeLessThan(12);
});

it("reads on from the nearest time where even that has too many messages", async () => {
  const { using, requests } = viewerAt(300n * SECOND, { stepNs: 5_000n });
  const { read, failure } = using(() => useMessages(() => series, "plain", () => 0));
  await settled();
  expect(failure.value).toBeNull();
  expect(read.value?.fromNs).toBe(300n * SECOND - 50_000_000n);
  expect(read.value?.toNs).toBeGreaterThanOrEqual(300n * SECOND);
  expect(requests.length).toBeLessThan(30);
});

it("reads around the play head although it does not move, and on until it is covered", async () => {
  const { using, requests } = viewerAt(300n * SECOND, { stepNs: SECOND });
  const { unread, failure } = using(() => useCurves(() => series, () => 0));
  await settled();
  expect(failure.value).toBeNull();
  expect(requests[0]?.fromNs).toBe(0n);
  expect(requests[1]?.fromNs).toBe(298n * SECOND);
  expect(unread.value.some(({ fromNs, toNs }) => fromNs <= 300n * SECOND && toNs >= 300n * SECOND)).toBe(false);
  expect(requests.length).toBeLessThan(5);
});

it.each(["curves", "parts"] as const)("reads where the play head went while something was read: %s", async (kind) => {
  const { using, requests, clock } = viewerAt(0n, { stepNs: 1_000_000n });
  const gathering = { product: "plain", empty: 0, add: (count: number) => count } as const;
  const { unread } = using(() => (kind === "curves" ? useCurves(() => series, () => 0) : useParts(() => series, gathering, () => 0)));
  while (requests.length === 0) await Promise.resolve();
  clock.seek(400n * SECOND);
  await settled();
  expect(unread.value.some(({ fromNs, toNs }) => fromNs <= 400n * SECOND && toNs >= 400n * SECOND)).toBe(false);
  expect(requests.length).toBeLessThan(10);
});
