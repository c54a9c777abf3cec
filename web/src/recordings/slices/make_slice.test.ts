// @vitest-environment node
import { readFile } from "node:fs/promises";
import { expect, it, describe } from "vitest";
import { openRecording } from "../formats/open";
import { madeMcap, storeOf } from "../testing/recordings";
import { makeSlice } from "./make_slice";
import { zstdCompression } from "./zstd";

const REQUEST = { topics: null, startNs: null, endNs: null, fileName: "drive.mcap", sha256: null, version: "1" };
const COUNT = 300;

/** A file that notes what happens to it. `failing`: the step that fails, as on a full disk. */
class FakeFile {
  readonly steps: string[] = [];
  onWrite: () => void = () => undefined;

  constructor(private readonly failing: "createWritable" | "write" | "close" | null = null) {}

  readonly handle = { createWritable: () => this.step("createWritable", this.writable) } as unknown as FileSystemFileHandle;

  private get writable() {
    return {
      write: () => {
        this.onWrite();
        return this.step("write", undefined);
      },
      close: () => this.step("close", undefined),
      abort: () => this.step("abort", undefined),
    };
  }

  private step<Result>(name: string, result: Result): Promise<Result> {
    this.steps.push(name);
    return name === this.failing ? Promise.reject(new DOMException("The disk is full.", "QuotaExceededError")) : Promise.resolve(result);
  }
}

async function make(handle: FileSystemFileHandle | null, signal = new AbortController().signal) {
  const topic = { name: "/a", schema: { name: "Noise", encoding: "jsonschema", data: new TextEncoder().encode("{}") }, messageEncoding: "json" };
  let state = 1;
  const noise = (): Uint8Array => Uint8Array.from({ length: 10_000 }, () => (state = (state * 48271) % 2147483647) & 255);
  const messages = Array.from({ length: COUNT }, (_, number) => ({ topic: "/a", logTimeNs: BigInt(number + 1), data: noise() }));
  const recording = await openRecording("mcap", storeOf(await madeMcap([topic], messages, { chunkSize: 2 ** 18 })).ranges);
  return makeSlice(recording, { ...REQUEST, handle }, { signal, pause: () => Promise.resolve(), onCurves: () => undefined, onSliced: () => undefined });
}

describe("a slice in a file", () => {
  it("appears once it is whole", async () => {
    const file = new FakeFile();
    expect(await make(file.handle)).toMatchObject({ messages: COUNT, blob: null });
    expect([file.steps.at(-1), file.steps.includes("abort")]).toEqual(["close", false]);
  });

  it.each(["createWritable", "write", "close"] as const)("is discarded if %s fails, with the reason", async (failing) => {
    const file = new FakeFile(failing);
    await expect(make(file.handle)).rejects.toMatchObject({ code: "not_saved", detail: "The disk is full." });
    expect(file.steps.slice(file.steps.indexOf(failing))).toEqual(failing === "createWritable" ? [failing] : [failing, "abort"]);
  });

  it("is discarded if it is cancelled", async () => {
    const controller = new AbortController();
    const file = new FakeFile();
    file.onWrite = () => controller.abort();
    await expect(make(file.handle, controller.signal)).rejects.toMatchObject({ code: "cancelled" });
    expect(file.steps).toEqual(["createWritable", "write", "abort"]);
  });
});

it("is returned from memory where the browser cannot write files", async () => {
  const { blob, bytes } = await make(null);
  expect(blob?.size).toBe(bytes);
});

it("is compressed as python-zstandard does it, which tests/unit/recordings/test_zstd_frame.py checks", async () => {
  const expected = JSON.parse(await readFile(new URL("../../../../tests/recording_files/zstd_frame.json", import.meta.url), "utf8")) as { sha256: string };
  const frame = (await zstdCompression()).compress(Uint8Array.from({ length: 300_000 }, (_, at) => ((at * at) % 251) ^ (at >> 7)));
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", frame.slice()));
  expect(Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("")).toBe(expected.sha256);
});
