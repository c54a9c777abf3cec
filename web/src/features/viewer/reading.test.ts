import { flushPromises, mount } from "@vue/test-utils";
import { afterEach, expect, it, vi } from "vitest";
import { effectScope, nextTick, ref } from "vue";
import { useClock } from "./clock";
import { Previews } from "./previews";
import { Sources, type FileReader } from "./sources";
import { useCurves } from "./useCurves";
import { useMessages } from "./useMessages";
import { useParts } from "./useParts";
import { viewerKey, type Viewer } from "./viewer";
import { ReadFailure } from "@/recordings/failures";
import type { MessagesRequest } from "@/recordings/products/products";
import type { PreviewFile } from "@/recordings/preview_file";
import type { CurvesRequest } from "@/recordings/protocol";

const SECOND = 1_000_000_000n;
const SPAN = { fromNs: 0n, toNs: 600n * SECOND };
const series = { recording: "k", topic: "/t", fields: ["x"] };
/** Something that never ends would make more requests. */
const MOST_REQUESTS = 100;
const TOPIC_BYTES = 3 * 2 ** 30;

interface Made {
  readonly stepNs: bigint;
  /** How much of the time one request for curves reads. */
  readonly curvesNs?: bigint;
  readonly sizeBytes?: number;
  readonly preview?: Partial<PreviewFile>;
  readonly isWhole?: boolean;
  /** Resolves before the reader tells the fields of the topic. */
  readonly beforeFields?: Promise<void>;
  /** Whether curves come only when they are cancelled. */
  readonly isBlocked?: () => boolean;
}

/** A viewer of one file with a message in every step of time. */
function viewerAt(startNs: bigint, { stepNs, curvesNs = SECOND, sizeBytes = 1, preview, isWhole = true, beforeFields = Promise.resolve(), isBlocked = () => false }: Made) {
  const requests: { readonly fromNs: bigint; readonly toNs: bigint }[] = [];
  const signals: AbortSignal[] = [];
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
    request: async (kind: string, request: CurvesRequest, { signal }: { signal: AbortSignal }) => {
      await Promise.resolve();
      if (kind === "fields") {
        await beforeFields;
        return { fields: [{ path: "x", name: "x", isNumber: true, children: [] }] };
      }
      note(request);
      signals.push(signal);
      if (isBlocked()) await new Promise((_, reject) => signal.addEventListener("abort", () => reject(new ReadFailure("cancelled"))));
      const untilNs = request.fromNs + curvesNs < request.toNs ? request.fromNs + curvesNs : request.toNs;
      return { seconds: [], values: [[]], messages: 0, isWhole, damaged: [], wholeBytes: 2 ** 30, topicBytes: TOPIC_BYTES, untilNs, unstamped: 0 };
    },
    close: () => undefined,
  } as unknown as FileReader;
  const file = { id: "f", path: "f.mcap", format: "mcap", size_bytes: sizeBytes, span: SPAN } as const;
  const sources = new Sources([{ key: "k", name: "", files: [file] }], () => reader);
  const clock = effectScope().run(() => useClock(SPAN, [SPAN], startNs));
  if (clock === undefined) throw new Error("no clock");
  const previews = new Previews(() => Promise.resolve((preview ?? null) as PreviewFile | null));
  const viewer: Viewer = { clock, sources, previews, topics: [], locations: [], selected: ref(0) };
  /** Runs a composable in the viewer. */
  function using<Result>(setup: () => Result): Result {
    const results: Result[] = [];
    mount({ setup: () => void results.push(setup()), template: "<i/>" }, { global: { provide: { [viewerKey as symbol]: viewer } } });
    return results[0] as Result;
  }
  return { clock, requests, signals, using };
}

afterEach(() => vi.useRealTimers());

async function settled(): Promise<void> {
  await nextTick();
  await flushPromises();
}

/** Waits until reading goes on after a jump. */
async function rested(): Promise<void> {
  await settled();
  await vi.runAllTimersAsync();
  await settled();
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
  const { unread, failure } = using(() => useCurves(() => series, () => 0, () => null));
  await settled();
  expect(failure.value).toBeNull();
  expect(requests[0]?.fromNs).toBe(0n);
  expect(requests[1]?.fromNs).toBe(298n * SECOND);
  expect(unread.value.some(({ fromNs, toNs }) => fromNs <= 300n * SECOND && toNs >= 300n * SECOND)).toBe(false);
  expect(requests.length).toBeLessThan(5);
});

it.each(["curves", "parts"] as const)("reads where the play head went while something was read: %s", async (kind) => {
  vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout"] });
  const { using, requests, clock } = viewerAt(0n, { stepNs: 1_000_000n });
  const gathering = { product: "plain", empty: 0, add: (count: number) => count } as const;
  const { unread } = using(() => (kind === "curves" ? useCurves(() => series, () => 0, () => null) : useParts(() => series, gathering, () => 0)));
  while (requests.length === 0) await Promise.resolve();
  clock.seek(400n * SECOND);
  await rested();
  expect(unread.value.some(({ fromNs, toNs }) => fromNs <= 400n * SECOND && toNs >= 400n * SECOND)).toBe(false);
  expect(requests.length).toBeLessThan(10);
});

it("ends what it reads around the play head at a jump, and begins anew after others; small steps change nothing", async () => {
  vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout"] });
  let isBlocked = true;
  const { using, requests, signals, clock } = viewerAt(300n * SECOND, { ...LARGE, preview: { series: () => Promise.resolve(BINS) }, isBlocked: () => isBlocked });
  const { failure, unread } = using(() => useCurves(() => series, () => 0, () => null));
  await settled();
  expect(requests).toEqual([{ fromNs: 298n * SECOND, toNs: 315n * SECOND }]);
  clock.seek(300n * SECOND + SECOND / 2n);
  await settled();
  expect(signals.map(({ aborted }) => aborted)).toEqual([false]);
  for (const second of [200n, 150n, 100n]) {
    clock.seek(second * SECOND);
    await settled();
  }
  expect(signals.map(({ aborted }) => aborted)).toEqual([true]);
  expect(requests).toHaveLength(1);
  isBlocked = false;
  await rested();
  expect(requests.slice(1)).toEqual([{ fromNs: 98n * SECOND, toNs: 115n * SECOND }]);
  expect(failure.value).toBeNull();
  expect(unread.value.map(({ fromNs }) => fromNs)).toEqual([0n, 115n * SECOND + 1n]);
  isBlocked = true;
  for (const second of [400n, 500n]) {
    clock.seek(second * SECOND);
    await rested();
  }
  expect(unread.value.map(({ fromNs }) => fromNs)).toEqual([0n, 115n * SECOND + 1n]); // what was read before stays
});

const MINUTES = Array.from({ length: 10 }, (_, minute) => BigInt(minute) * 60n * SECOND);
const BINS = {
  messagesPerBin: 600,
  firstNs: new BigInt64Array(MINUTES),
  lastNs: new BigInt64Array(MINUTES.map((timeNs) => timeNs + 59n * SECOND)),
  fields: [{ low: MINUTES.map((_, minute) => -minute), high: MINUTES.map((_, minute) => minute) }],
  readSpans: new BigInt64Array(),
};
const LARGE = { stepNs: 1_000_000n, curvesNs: 100n * SECOND, sizeBytes: 50e9 };

it("draws the preview of a large recording before its fields are read", async () => {
  let giveFields = (): void => undefined;
  const beforeFields = new Promise<void>((resolve) => (giveFields = resolve));
  const { using, requests } = viewerAt(300n * SECOND, { ...LARGE, beforeFields, preview: { series: () => Promise.resolve(BINS), fieldsOf: () => ["x"] } });
  const { rough, curves, failure } = using(() => useCurves(() => series, () => 0, () => null));
  await settled();
  expect(failure.value).toBeNull();
  expect(curves.value.map(({ column }) => column)).toEqual(["x"]);
  expect(rough.value.length).toBeGreaterThan(0);
  expect(requests).toEqual([]);
  giveFields();
  await settled();
  expect(requests.length).toBeGreaterThan(0);
});

it("draws all curves of a layout while only the fields of a preview are known", async () => {
  const fields = ["norm(velocity)", "derivative(hidden)", "difference(x,hidden)"];
  const never = new Promise<void>(() => undefined);
  const { using } = viewerAt(300n * SECOND, { ...LARGE, beforeFields: never, preview: { series: () => Promise.resolve(BINS), fieldsOf: () => ["x", "velocity.x", "velocity.y"] } });
  const { curves } = using(() => useCurves(() => ({ ...series, fields }), () => 0, () => null));
  const { curves: defaults } = using(() => useCurves(() => ({ ...series, fields: [] }), () => 0, () => null));
  await settled();
  expect(curves.value.map(({ column }) => column)).toEqual(fields);
  expect(defaults.value.map(({ column }) => column)).toEqual(["x", "velocity.x", "velocity.y"]);
});

it("shows the preview of a large recording, and reads only what is around the play head and zoomed in", async () => {
  vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout"] });
  const { using, requests } = viewerAt(300n * SECOND, { ...LARGE, preview: { series: () => Promise.resolve(BINS) } });
  const zoomed = ref<{ fromNs: bigint; toNs: bigint } | null>(null);
  const { rough, unread, wholeBytes } = using(() => useCurves(() => series, () => 0, () => zoomed.value));
  await settled();
  expect(requests).toEqual([{ fromNs: 298n * SECOND, toNs: 315n * SECOND }]);
  expect(wholeBytes.value).toBe(TOPIC_BYTES); // not only what is around the play head
  const seconds = rough.value.flatMap((segment) => segment.seconds);
  expect(seconds).toHaveLength(18); // of two bins, one end was read
  expect(seconds.some((second) => second >= 298 && second <= 315)).toBe(false);
  zoomed.value = { fromNs: 100n * SECOND, toNs: 150n * SECOND };
  await settled();
  vi.runAllTimers();
  await settled();
  expect(requests[1]).toEqual({ fromNs: 100n * SECOND, toNs: 150n * SECOND });
  expect(requests).toHaveLength(2);
  expect(unread.value.map(({ fromNs }) => fromNs)).toEqual([0n, 150n * SECOND + 1n, 315n * SECOND + 1n]);
});

it("reads no more than the limit of what is zoomed in", async () => {
  vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout"] });
  const { using, requests } = viewerAt(300n * SECOND, { ...LARGE, preview: { series: () => Promise.resolve(BINS) } });
  const zoomed = ref<{ fromNs: bigint; toNs: bigint } | null>(null);
  using(() => useCurves(() => series, () => 0, () => zoomed.value));
  await settled();
  zoomed.value = { fromNs: 250n * SECOND, toNs: 400n * SECOND }; // two unread parts, of which one request needs 1 GiB
  await settled();
  vi.runAllTimers();
  await settled();
  expect(requests.slice(1)).toEqual([{ fromNs: 250n * SECOND, toNs: 298n * SECOND - 1n }]);
});

it("reads again what is zoomed in of a curve that is drawn by its extremes", async () => {
  vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout"] });
  const { using, requests } = viewerAt(0n, { stepNs: 1_000_000n, curvesNs: 600n * SECOND, isWhole: false });
  const zoomed = ref<{ fromNs: bigint; toNs: bigint } | null>(null);
  const { segments } = using(() => useCurves(() => series, () => 0, () => zoomed.value));
  await settled();
  expect(requests).toEqual([SPAN]);
  zoomed.value = { fromNs: 100n * SECOND, toNs: 150n * SECOND };
  await settled();
  vi.runAllTimers();
  await settled();
  expect(requests.slice(1)).toEqual([zoomed.value]);
  expect(segments.value.map(({ fromNs, toNs }) => [fromNs, toNs])).toEqual([[0n, 100n * SECOND - 1n], [150n * SECOND + 1n, 600n * SECOND], [100n * SECOND, 150n * SECOND]]);
});

it("reads anew with the fields that other topics subtract, and with another time", async () => {
  const { using, requests } = viewerAt(0n, { stepNs: 1_000_000n, curvesNs: 600n * SECOND });
  const [operands, time] = [ref<readonly string[]>([]), ref<"log" | "header">("log")];
  const { columns } = using(() => useCurves(() => series, () => 0, () => null, { operands: () => operands.value, time: () => time.value }));
  await settled();
  expect(columns.value).toEqual(["x"]);
  operands.value = ["y", "x"];
  await settled();
  expect(columns.value).toEqual(["x", "y"]);
  expect(requests).toHaveLength(2);
  operands.value = ["y", "x"];
  await settled();
  expect(requests).toHaveLength(2);
  time.value = "header";
  await settled();
  expect(requests).toHaveLength(3);
});

it.each([
  ["has no preview", undefined],
  ["has a damaged preview", { series: () => Promise.reject(new ReadFailure("index_damaged")) }],
  ["has a preview without the topic", { series: () => Promise.resolve(null) }],
])("reads the beginning of a large recording that %s", async (_, preview) => {
  const { using, requests } = viewerAt(0n, preview === undefined ? LARGE : { ...LARGE, preview });
  const { failure, rough } = using(() => useCurves(() => series, () => 0, () => null));
  await settled();
  expect(failure.value).toBeNull();
  expect(rough.value).toEqual([]);
  expect(requests[0]).toEqual(SPAN);
});
