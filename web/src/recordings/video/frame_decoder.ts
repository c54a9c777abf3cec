/** Decodes coded frames with WebCodecs. Holds one decoded frame at most, and a few coded ones. */

import { ReadFailure } from "../failures";
import { checkSize } from "../pictures/pixels";
import type { VideoFormat } from "./bitstream";

export interface CodedFrame {
  data: Uint8Array;
  isKey: boolean;
}

/** Coded frames that wait in the decoder. */
const MAX_QUEUE = 8;
/** Where nothing was decoded for so long, the decoder waits for further frames, and is told that there are none. */
const IDLE_TIMEOUT_MS = 400;
const FLUSH_TIMEOUT_MS = 10_000;

/** @throws ReadFailure video_insecure, video_missing, video_codec: why the browser does not decode the codec. */
export async function checkVideoSupport(format: VideoFormat, codec: string): Promise<void> {
  if (typeof VideoDecoder === "undefined") throw new ReadFailure(globalThis.isSecureContext ? "video_missing" : "video_insecure");
  let isSupported: boolean | undefined;
  try {
    isSupported = (await VideoDecoder.isConfigSupported({ codec })).supported;
  } catch {
    isSupported = false; // a name of a codec that the browser cannot parse
  }
  if (isSupported !== true) throw new ReadFailure("video_codec", `${format}, ${codec}`);
}

export class FrameDecoder {
  private readonly decoder: VideoDecoder;
  /** Stays open until there is another one, since several panels may show it. */
  private latest: VideoFrame | null = null;
  private failure: ReadFailure | null = null;
  private number = 0;
  private isFlushed = false;
  private wake: () => void = () => undefined;

  constructor(readonly codec: string) {
    this.decoder = new VideoDecoder({ output: (frame) => this.receive(frame), error: ({ message }) => this.fail(message) });
    this.decoder.ondequeue = () => this.wake();
    this.decoder.configure({ codec, optimizeForLatency: true });
  }

  /** Decode frames in order, the first of which continues those before; return the picture of the last one.
   *
   * @throws ReadFailure picture_unreadable, picture_too_large; then the decoder must be closed. What `check` throws.
   */
  async decode(frames: readonly CodedFrame[], check: () => void): Promise<ImageBitmap> {
    this.forget();
    for (const { data, isKey } of frames) {
      while (this.decoder.decodeQueueSize >= MAX_QUEUE && this.failure === null) await this.change();
      check();
      if (this.failure !== null) throw this.failure;
      this.number += 1;
      this.attempt(() => this.decoder.decode(new EncodedVideoChunk({ type: isKey ? "key" : "delta", timestamp: this.number, data })));
    }
    await this.last();
    return this.picture();
  }

  /** Return the picture of the last frame again. @throws ReadFailure picture_unreadable, picture_too_large. */
  async picture(): Promise<ImageBitmap> {
    const { failure, latest } = this;
    if (failure !== null || latest === null) throw failure ?? new ReadFailure("picture_unreadable", this.codec);
    checkSize(latest.displayWidth, latest.displayHeight);
    return createImageBitmap(latest);
  }

  /** Whether the next frame must be a key frame. */
  get isAtEnd(): boolean {
    return this.isFlushed || this.failure !== null;
  }

  close(): void {
    this.forget();
    if (this.decoder.state !== "closed") this.decoder.close();
  }

  /** Wait for the last frame. */
  private async last(): Promise<void> {
    while (this.failure === null && this.latest?.timestamp !== this.number) {
      if (await this.change()) continue;
      this.isFlushed = true;
      await Promise.race([this.decoder.flush().catch(() => undefined), pause(FLUSH_TIMEOUT_MS)]);
      return;
    }
  }

  private forget(): void {
    this.latest?.close();
    this.latest = null;
  }

  private receive(frame: VideoFrame): void {
    this.forget();
    this.latest = frame;
    this.wake();
  }

  private fail(message: string): void {
    this.failure ??= new ReadFailure("picture_unreadable", message.slice(0, 100));
    this.wake();
  }

  private attempt(act: () => void): void {
    try {
      act();
    } catch (thrown) {
      this.fail(thrown instanceof Error ? thrown.message : "");
    }
  }

  /** Wait for the decoder; returns false where nothing happened. */
  private change(): Promise<boolean> {
    return new Promise((resolve) => {
      const timer = setTimeout(() => resolve(false), IDLE_TIMEOUT_MS);
      this.wake = () => {
        clearTimeout(timer);
        resolve(true);
      };
    });
  }
}

function pause(milliseconds: number): Promise<void> {
  return new Promise((resolve) => setTimeout(resolve, milliseconds));
}
