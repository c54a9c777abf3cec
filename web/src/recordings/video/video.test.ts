import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { openRecording } from "../formats/open";
import type { ReadMessage } from "../products/products";
import { Session } from "../session";
import { madeMcap, storeOf } from "../testing/recordings";
import { keyFrameCodec } from "./bitstream";

const H264_SPS = [0, 0, 0, 1, 0x67, 0x42, 0xc0, 0x1f, 0xd9];
const H264_PPS = [0, 0, 1, 0x68, 0xce];
const H265_SPS = [0, 0, 0, 1, 0x42, 1, 1, 1, 0x60, 0, 0, 3, 0, 0x90, 0, 0, 3, 0, 0, 3, 0, 0x5d, 0xa0];
const KEY = 0x82;
const BETWEEN = 0x86;

describe("keyFrameCodec", () => {
  it.each([
    ["h264", [...H264_SPS, ...H264_PPS, 0, 0, 1, 0x65, 0x88], "avc1.42c01f"],
    ["h264", [...H264_PPS, 0, 0, 1, 0x65, 0x88], null],
    ["h264", [...H264_SPS, ...H264_PPS, 0, 0, 1, 0x41, 0x9a], null],
    ["h265", [0, 0, 0, 1, 0x40, 1, 0xc, ...H265_SPS, 0, 0, 1, 0x26, 1], "hev1.1.6.L93.90"],
    ["h265", [...H265_SPS, 0, 0, 1, 0x02, 1], null],
    ["vp9", [KEY, 0x49, 0x83, 0x42], "vp09.00.10.08"],
    ["vp9", [0x92, 0x49], "vp09.02.10.10"],
    ["vp9", [BETWEEN, 0], null],
    ["vp9", [0x8a, 0], null],
    ["vp9", [0x42, 0], null],
    ["av1", [0x12, 0, 0x0a, 3, 0x20, 0, 0, 0x32, 1, 0], "av01.1.08M.08"],
    ["av1", [0x12, 0, 0x32, 2, 0x0a, 0], null],
    ["av1", [0x08, 0x00, 0x00], "av01.0.08M.08"],
    ["av1", [0x12, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], null],
    ["h264", [], null], ["h265", [], null], ["vp9", [], null], ["av1", [], null],
  ] as const)("reads %s", (format, data, codec) => expect(keyFrameCodec(format, Uint8Array.from(data))).toBe(codec));
});

/** What the decoder of the browser does, as far as it is used: answers later, and needs a key frame first. */
class Decoder {
  static made: Decoder[] = [];
  static openFrames = 0;
  static longestQueue = 0;
  static isDelayed = false;
  state = "unconfigured";
  decodeQueueSize = 0;
  ondequeue: (() => void) | null = null;
  readonly types: string[] = [];
  private needsKey = true;
  private delayed: number[] = [];

  static isConfigSupported({ codec }: { codec: string }): Promise<{ supported: boolean }> {
    return Promise.resolve({ supported: codec.startsWith("vp09.00") });
  }

  constructor(private readonly on: { output: (frame: object) => void; error: (error: Error) => void }) {
    Decoder.made.push(this);
  }

  configure(): void {
    this.state = "configured";
  }

  decode({ type, timestamp, data }: { type: string; timestamp: number; data: Uint8Array }): void {
    if (this.needsKey && type !== "key") throw new Error("A key frame is required");
    this.needsKey = false;
    this.types.push(type);
    this.decodeQueueSize += 1;
    Decoder.longestQueue = Math.max(Decoder.longestQueue, this.decodeQueueSize);
    setTimeout(() => {
      this.decodeQueueSize -= 1;
      this.ondequeue?.();
      if (data[1] === 0xff) this.on.error(new Error("Decoding error."));
      else if (Decoder.isDelayed) this.delayed.push(timestamp);
      else this.give(timestamp);
    });
  }

  flush(): Promise<void> {
    this.needsKey = true;
    this.delayed.forEach((timestamp) => this.give(timestamp));
    return Promise.resolve();
  }

  close(): void {
    this.state = "closed";
  }

  private give(timestamp: number): void {
    Decoder.openFrames += 1;
    this.on.output({ timestamp, displayWidth: 4, displayHeight: 2, close: () => (Decoder.openFrames -= 1) });
  }
}

const COUNT = 120;
const timeOf = (number: number): bigint => BigInt(number + 1) * 100_000_000n;

/** A key frame every 50 frames from the tenth on. */
async function opened(change: (number: number) => number[] = () => []): Promise<Session> {
  const text = new TextEncoder().encode("{}");
  const messages = Array.from({ length: COUNT }, (_, number) => {
    const changed = change(number);
    const frame = changed.length > 0 ? changed : [number % 50 === 10 ? KEY : BETWEEN, number];
    const content = { timestamp: { sec: number, nsec: 1 }, format: "vp9", data: btoa(String.fromCharCode(...frame)) };
    return { topic: "/video", logTimeNs: timeOf(number), data: new TextEncoder().encode(JSON.stringify(content)) };
  });
  const topics = [{ name: "/video", schema: { name: "foxglove.CompressedVideo", encoding: "jsonschema", data: text }, messageEncoding: "json" }];
  return new Session(await openRecording("mcap", storeOf(await madeMcap(topics, messages, { chunkSize: 1_000 })).ranges));
}

async function at(session: Session, number: number, signal?: AbortSignal): Promise<ReadMessage | null> {
  const request = { topic: "/video", which: "valid", atNs: timeOf(number), product: "picture", shownNs: null, maxBytes: Infinity } as const;
  return (await session.message(request, signal)).message;
}

describe("a video", () => {
  beforeEach(() => {
    Object.assign(Decoder, { made: [], openFrames: 0, longestQueue: 0, isDelayed: false });
    vi.stubGlobal("VideoDecoder", Decoder);
    vi.stubGlobal("EncodedVideoChunk", function (this: object, init: object) {
      Object.assign(this, init);
    });
    vi.stubGlobal("createImageBitmap", ({ timestamp }: { timestamp: number }) => Promise.resolve({ width: 4, height: 2, timestamp }));
  });
  afterEach(() => vi.unstubAllGlobals());

  it("is decoded from the last key frame on, with a bounded queue, and every frame but the shown one is closed", async () => {
    const shown = await at(await opened(), 45);
    expect(shown?.logTimeNs).toBe(timeOf(45));
    expect(shown?.product).toMatchObject({ image: { timestamp: 36 }, width: 4, height: 2, encoding: "vp9", stampSeconds: 45.000000001 });
    expect(Decoder.made.map(({ types }) => types)).toEqual([["key", ...Array<string>(35).fill("delta")]]);
    expect([Decoder.openFrames, Decoder.longestQueue]).toEqual([1, 8]);
  });

  it("goes on with the frames behind, and begins anew where it goes back or far", async () => {
    const session = await opened();
    for (const number of [12, 13, 16, 15, 100]) await at(session, number);
    expect(Decoder.made.map(({ types }) => types.length)).toEqual([7, 6, 41]);
    expect(Decoder.made.map(({ state }) => state)).toEqual(["closed", "closed", "configured"]);
  });

  it("decodes a frame once that two panels show", async () => {
    const session = await opened();
    for (const number of [12, 12, 13, 13]) expect((await at(session, number))?.product).toMatchObject({ image: { timestamp: number - 9 } });
    expect(Decoder.made.map(({ types }) => types)).toEqual([["key", "delta", "delta", "delta"]]);
    expect(Decoder.openFrames).toBe(1);
  });

  it("gets the picture of a decoder that waits for further frames", async () => {
    Decoder.isDelayed = true;
    const session = await opened();
    expect((await at(session, 12))?.product).toMatchObject({ image: { timestamp: 3 } });
    expect((await at(session, 13))?.product).toMatchObject({ image: { timestamp: 4 } });
    expect([Decoder.made.length, Decoder.openFrames]).toEqual([2, 1]);
  });

  it("closes a decoder that is not used", async () => {
    vi.useFakeTimers({ shouldAdvanceTime: true });
    const session = await opened();
    await at(session, 12);
    await vi.advanceTimersByTimeAsync(9_000);
    await at(session, 13);
    await vi.advanceTimersByTimeAsync(9_000);
    expect(Decoder.made.map(({ state }) => state)).toEqual(["configured"]);
    await vi.advanceTimersByTimeAsync(2_000);
    expect(Decoder.made.map(({ state }) => state)).toEqual(["closed"]);
    expect(Decoder.openFrames).toBe(0);
    await at(session, 14);
    expect(Decoder.made).toHaveLength(2);
    vi.useRealTimers();
  });

  it("says why there is no picture", async () => {
    const session = await opened();
    await expect(at(session, 5)).rejects.toMatchObject({ code: "video_no_key_frame" });
    await expect(at(await opened((number) => (number === 12 ? [BETWEEN, 0xff] : [])), 14)).rejects.toMatchObject({ code: "picture_unreadable", detail: "Decoding error." });
    await expect(at(await opened((number) => (number === 10 ? [0x92, 1] : [])), 14)).rejects.toMatchObject({ code: "video_codec", detail: "vp9, vp09.02.10.10" });
    expect(Decoder.made.every(({ state }) => state === "closed")).toBe(true);
    await expect(at(session, 14, AbortSignal.abort())).rejects.toMatchObject({ code: "cancelled" });
    vi.stubGlobal("VideoDecoder", undefined);
    vi.stubGlobal("isSecureContext", false);
    await expect(at(session, 14)).rejects.toMatchObject({ code: "video_insecure" });
    vi.stubGlobal("isSecureContext", true);
    await expect(at(session, 14)).rejects.toMatchObject({ code: "video_missing" });
    expect(Decoder.openFrames).toBe(0);
  });
});
