import { expect, it } from "vitest";
import { MAX_READERS, recordedSpans, Sources, type FileReader, type SourceFile, type SourceRecording } from "./sources";
import { ReadFailure } from "@/recordings/failures";
import type { MessageRequest } from "@/recordings/products/products";

const file = (id: string, fromNs: bigint, toNs: bigint): SourceFile => ({ id, path: `${id}.mcap`, format: "mcap", size_bytes: 1, span: { fromNs, toNs } });
const split: SourceRecording = { key: "k", name: "split", files: [file("a", 0n, 99n), file("b", 100n, 199n), file("c", 200n, 299n)] };
const series = { recording: "k", topic: "/t", fields: [] };

/** Files with messages at these times; null: without the topic. */
function sourcesOf(times: Readonly<Record<string, readonly bigint[] | null>>, recording = split) {
  const requested: string[] = [];
  const closed: string[] = [];
  const openReader = (of: SourceFile): FileReader => ({
    open: () => Promise.reject(new Error("not needed")),
    messages: () => Promise.reject(new Error("not needed")),
    request: () => Promise.reject(new Error("not needed")),
    close: () => closed.push(of.id),
    message: (({ which, atNs }: MessageRequest) => {
      requested.push(of.id);
      const own = times[of.id];
      if (own == null) return Promise.reject(new ReadFailure("topic_unknown"));
      const timeNs = which === "next" ? own.find((time) => time > atNs) : own.findLast((time) => (which === "valid" ? time <= atNs : time < atNs));
      const message = timeNs === undefined ? null : { logTimeNs: timeNs, publishTimeNs: timeNs, sequence: 0, sizeBytes: 1, product: null };
      return Promise.resolve({ message, searchedToNs: null, damaged: [] });
    }),
  });
  return { sources: new Sources([recording], openReader), requested, closed };
}

const request = (which: "valid" | "next" | "previous", atNs: bigint) => ({ which, atNs, product: "time", shownNs: null, maxBytes: 1 }) as const;

it("finds a message in the file of its time, and reads no other", async () => {
  const { sources, requested } = sourcesOf({ a: [10n], b: [110n, 150n], c: [210n] });
  expect((await sources.message(series, request("valid", 120n), {})).message?.logTimeNs).toBe(110n);
  expect(requested).toEqual(["b"]);
});

it("goes to the files before and behind, past those without the topic", async () => {
  const { sources } = sourcesOf({ a: [10n], b: null, c: [210n] });
  expect((await sources.message(series, request("valid", 150n), {})).message?.logTimeNs).toBe(10n);
  expect((await sources.message(series, request("next", 10n), {})).message?.logTimeNs).toBe(210n);
  expect((await sources.message(series, request("previous", 210n), {})).message?.logTimeNs).toBe(10n);
  expect((await sources.message(series, request("next", 210n), {})).message).toBeNull();
});

it("compares the messages of files that overlap", async () => {
  const overlapping = { ...split, files: [file("a", 0n, 150n), file("b", 100n, 199n)] };
  const { sources } = sourcesOf({ a: [140n], b: [110n] }, overlapping);
  expect((await sources.message(series, request("valid", 145n), {})).message?.logTimeNs).toBe(140n);
});

it("passes on what else fails", async () => {
  await expect(sourcesOf({}).sources.message({ ...series, recording: "gone" }, request("valid", 1n), {})).rejects.toMatchObject({ code: "topic_unknown" });
});

it("ends the reader that was not used for the longest time", async () => {
  const files = Array.from({ length: MAX_READERS + 1 }, (_, at) => file(String(at), BigInt(at * 10), BigInt(at * 10 + 9)));
  const { sources, closed } = sourcesOf(Object.fromEntries(files.map(({ id, span }) => [id, [span.fromNs]])), { key: "k", name: "", files });
  for (const { span } of files) await sources.message(series, request("valid", span.toNs), {});
  expect(closed).toEqual(["0"]);
  sources.close();
  expect(closed).toHaveLength(MAX_READERS + 1);
});

it("asks a file for its last message once, where the play head is behind the file and the message is shown", async () => {
  const { sources, requested } = sourcesOf({ a: [10n], b: null, c: [210n] });
  const at = async (atNs: bigint, shownNs: bigint | null) => (await sources.message(series, { ...request("valid", atNs), shownNs }, {})).message?.logTimeNs;
  expect(await at(202n, null)).toBe(10n);
  expect(await at(203n, 10n)).toBe(10n);
  expect(requested).toEqual(["c", "b", "a", "c"]);
  expect(await at(204n, null)).toBe(10n); // its product is not known any more
  expect(requested).toEqual(["c", "b", "a", "c", "c", "a"]);
  expect(await at(150n, 10n)).toBe(10n); // within the file without the topic
  expect(await at(5n, 10n)).toBeUndefined();
});

it("starts no reader after it was closed", async () => {
  const { sources, requested } = sourcesOf({ a: [10n] });
  sources.close();
  await expect(sources.message(series, request("valid", 50n), {})).rejects.toMatchObject({ code: "cancelled" });
  expect(requested).toEqual([]);
});

it("merges the times at which recordings ran", () => {
  const other = { ...split, files: [file("x", 50n, 120n), file("y", 900n, 950n)] };
  expect(recordedSpans([split, other])).toEqual([{ fromNs: 0n, toNs: 199n }, { fromNs: 200n, toNs: 299n }, { fromNs: 900n, toNs: 950n }]);
});
