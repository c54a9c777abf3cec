/** Pictures of video topics (foxglove.CompressedVideo), which need the frames before them, back to a key frame. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import type { Message, Order, Recording, Span } from "../formats/recording";
import { bytesOf, part, stampOf, textOf } from "../geometry/values";
import { MAX_VIDEO_BYTES, MAX_VIDEO_FRAMES, MAX_VIDEO_NS } from "../limits";
import type { DrawnPicture } from "../products/drawn_picture";
import { keyFrameCodec, VIDEO_FORMATS, type VideoFormat } from "./bitstream";
import { checkVideoSupport, FrameDecoder } from "./frame_decoder";

interface Frame {
  timeNs: bigint;
  data: Uint8Array;
  /** Null for frames that need others. */
  codec: string | null;
}

/** A decoder that has decoded the frames of a topic up to a time. */
interface Running {
  decoder: FrameDecoder;
  untilNs: bigint;
  /** Closes the decoder, unless further frames are requested. */
  closing: ReturnType<typeof setTimeout> | undefined;
}

const NAMES: Readonly<Record<string, VideoFormat>> = { hevc: "h265", avc: "h264" };
/** Decoders at once; a browser has a limited number of them. */
const MAX_DECODERS = 4;
/** A decoder that is not used for so long is closed. */
const CLOSE_AFTER_MS = 10_000;
/** Where more frames follow the ones that are decoded, it is checked whether a key frame is nearer. */
const FORWARD_NS = 1_000_000_000n;

export class VideoReader {
  /** By topic, the least recently used one first. */
  private readonly running = new Map<string, Running>();
  private signal: AbortSignal | undefined;

  constructor(
    private readonly recording: Recording,
    private readonly decode: (message: Message) => Value,
  ) {}

  /** Return the picture of a frame. One at a time.
   *
   * @throws ReadFailure cancelled, video_insecure, video_missing, video_codec, video_no_key_frame, pixels_unknown,
   *   picture_unreadable, picture_too_large; what reading throws.
   */
  async picture(message: Message, signal?: AbortSignal): Promise<DrawnPicture> {
    this.signal = signal;
    const { channel: { topic }, logTimeNs } = message;
    clearTimeout(this.running.get(topic)?.closing);
    try {
      const value = this.decode(message);
      const format = formatOf(value);
      const image = (await this.again(topic, logTimeNs)) ?? (await this.continued(topic, format, logTimeNs)) ?? (await this.fromKeyFrame(topic, format, logTimeNs));
      return { image, width: image.width, height: image.height, encoding: format, stampSeconds: stampOf(value) };
    } catch (thrown) {
      this.end(topic);
      throw thrown;
    }
  }

  /** The picture of the frame that was decoded last, which another panel shows; null for another frame. */
  private async again(topic: string, timeNs: bigint): Promise<ImageBitmap | null> {
    const running = this.running.get(topic);
    if (running?.untilNs !== timeNs) return null;
    const picture = await running.decoder.picture();
    this.closeLater(topic, running);
    return picture;
  }

  /** Decode the frames behind those that are decoded; null where the decoder cannot go on, or the codec changes. */
  private async continued(topic: string, format: VideoFormat, timeNs: bigint): Promise<ImageBitmap | null> {
    const running = this.running.get(topic);
    if (running === undefined || running.decoder.isAtEnd || timeNs <= running.untilNs || timeNs - running.untilNs > FORWARD_NS) return null;
    const frames: Frame[] = [];
    for await (const frame of this.frames(topic, format, { fromNs: running.untilNs + 1n, toNs: timeNs }, "forward")) {
      if (frame.codec !== null && frame.codec !== running.decoder.codec) return null;
      frames.push(frame);
    }
    return this.decoded(topic, running.decoder, frames);
  }

  private async fromKeyFrame(topic: string, format: VideoFormat, timeNs: bigint): Promise<ImageBitmap> {
    this.end(topic);
    const frames: Frame[] = [];
    const startNs = this.recording.span?.fromNs ?? timeNs;
    const fromNs = timeNs - MAX_VIDEO_NS < startNs ? startNs : timeNs - MAX_VIDEO_NS;
    for await (const frame of this.frames(topic, format, { fromNs, toNs: timeNs }, "backward")) {
      frames.unshift(frame);
      if (frame.codec !== null) break;
    }
    const codec = frames[0]?.codec;
    if (codec === undefined || codec === null) throw new ReadFailure("video_no_key_frame");
    await checkVideoSupport(format, codec);
    return this.decoded(topic, new FrameDecoder(codec), frames);
  }

  private async decoded(topic: string, decoder: FrameDecoder, frames: readonly Frame[]): Promise<ImageBitmap> {
    this.running.delete(topic);
    const running: Running = { decoder, untilNs: frames.at(-1)?.timeNs ?? 0n, closing: undefined };
    this.running.set(topic, running); // as the youngest
    for (const oldest of [...this.running.keys()].slice(0, -MAX_DECODERS)) this.end(oldest);
    const picture = await decoder.decode(frames.map(({ data, codec }) => ({ data, isKey: codec !== null })), () => this.check());
    this.closeLater(topic, running);
    return picture;
  }

  private closeLater(topic: string, running: Running): void {
    running.closing = setTimeout(() => this.end(topic), CLOSE_AFTER_MS);
  }

  /** The frames of a part of the time, up to the limits. @throws ReadFailure video_no_key_frame, where it needs more; damage. */
  private async *frames(topic: string, format: VideoFormat, span: Span, order: Order): AsyncIterable<Frame> {
    const { source } = this.recording;
    const startBytes = source.bytesRead;
    let [count, bytes] = [0, 0];
    const onDamage = ({ failure }: { failure: ReadFailure }): void => {
      throw failure;
    };
    for await (const message of this.recording.messages([topic], span, order, onDamage)) {
      const data = bytesOf(part(this.decode(message), "data"));
      [count, bytes] = [count + 1, bytes + (data?.length ?? 0)]; // frames of a compressed chunk can be larger than what is read
      if (count > MAX_VIDEO_FRAMES || Math.max(bytes, source.bytesRead - startBytes) > MAX_VIDEO_BYTES) throw new ReadFailure("video_no_key_frame");
      if (data === null || data.length === 0) throw new ReadFailure("picture_unreadable", "0 bytes");
      yield { timeNs: message.logTimeNs, data: data.slice(), codec: keyFrameCodec(format, data) };
      this.check();
    }
  }

  private check(): void {
    if (this.signal?.aborted === true) throw new ReadFailure("cancelled");
  }

  private end(topic: string): void {
    clearTimeout(this.running.get(topic)?.closing);
    this.running.get(topic)?.decoder.close();
    this.running.delete(topic);
  }
}

function formatOf(value: Value): VideoFormat {
  const name = textOf(part(value, "format")).toLowerCase();
  const format = Object.hasOwn(NAMES, name) ? NAMES[name] : VIDEO_FORMATS.find((one) => one === name);
  if (format === undefined) throw new ReadFailure("pixels_unknown", `video, ${name.slice(0, 40)}`);
  return format;
}
