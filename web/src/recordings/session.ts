/** One open recording and the requests that it answers, one at a time. Runs in the worker. */

import { CurveReading } from "./curves/curve_reading";
import { decoderOf, type Decode, type Value } from "./decoding/decoder";
import { fieldTree } from "./decoding/fields";
import { ReadFailure } from "./failures";
import { cost, type Message, type OnDamage, type Piece, type Recording, type Schema, type Span } from "./formats/recording";
import { MAX_DAMAGED, MAX_MESSAGES_AT_ONCE, READ_AHEAD } from "./limits";
import { MessageSearch } from "./message_search";
import { makers, type MessageRequest, type MessagesRequest, type ProductName, type Products, type ReadMessage } from "./products/products";
import type { CurvesRequest, DamagedPart, DrawnCurves, FoundMessage, OfferedFields, Opened, ReadMessages, SliceProgress } from "./protocol";
import { isVideoType } from "./video/bitstream";
import { VideoReader } from "./video/video_reader";

/** Receives curves and progress while something is read; `signal` cancels. */
export interface Observer {
  signal: AbortSignal;
  /** Serves requests that are more urgent. To be called now and then between two messages. @throws ReadFailure cancelled. */
  pause: () => Promise<void>;
  onCurves: (curves: DrawnCurves) => void;
  onSliced: (progress: SliceProgress) => void;
}

const REPORT_EVERY_MS = 400;
const PAUSE_EVERY_MS = 30;
const SECOND_NS = 1e9;
/** What is read to find the message before a part. */
const MAX_PREVIOUS_BYTES = 8 * 2 ** 20;
/** Where the pieces that are wanted are most of what lies between them, reading ahead saves requests. */
const DENSE = 0.5;

export class Session {
  private readonly decoders = new Map<Schema, Decode>();
  private readonly video: VideoReader;
  private searchOfAll: MessageSearch | null = null;

  constructor(readonly recording: Recording) {
    this.video = new VideoReader(recording, ({ channel, data }) => this.decoder(channel.schema)(data));
  }

  opened(): Opened {
    const topics = this.recording.topics.map(({ name, schema }) => ({ name, messageType: schema.name }));
    const { span, indexedUntil } = this.recording;
    return { span, indexedUntil, topics };
  }

  /** Find one message. @throws ReadFailure where it is damaged, or all that could be it. */
  async message({ topic, which, atNs, product, shownNs, maxBytes }: MessageRequest, signal?: AbortSignal): Promise<FoundMessage> {
    const noticed = new Damages(this.span(topic).fromNs);
    const { message, searchedToNs } = await this.search.find(topic, which, atNs, { maxBytes, onDamage: noticed.note });
    if (message === null && noticed.first !== null) throw noticed.first;
    const isShown = message !== null && message.logTimeNs === shownNs;
    return { message: message === null ? null : await this.made(message, isShown ? null : product, signal), searchedToNs, damaged: noticed.parts };
  }

  /** The first messages of a span, as far as the limits reach; damaged ones are left out. */
  async messages(request: MessagesRequest, { pause }: Pick<Observer, "pause">): Promise<ReadMessages> {
    const { topic, product, maxMessages, maxBytes, fromNs, toNs } = request;
    const noticed = new Damages(this.span(topic).fromNs);
    const span = affordable({ fromNs, toNs }, this.recording.pieces([topic], { fromNs, toNs }), maxBytes);
    const messages: ReadMessage[] = [];
    const timer = new Timer(PAUSE_EVERY_MS);
    const { source } = this.recording;
    const startBytes = source.bytesRead;
    for await (const message of this.recording.messages([topic], span, "forward", noticed.note)) {
      const last = messages.at(-1)?.logTimeNs;
      // A chunk is used as a whole, because it was read as a whole.
      const isTooLarge = last !== undefined && source.bytesRead - startBytes > maxBytes && message.chunkSpan.fromNs > last;
      // Messages of equal times stay together, so that the next request can begin behind them.
      if (last !== undefined && (messages.length >= maxMessages || isTooLarge) && message.logTimeNs > last) return { messages, untilNs: last, damaged: noticed.parts };
      if (messages.length >= MAX_MESSAGES_AT_ONCE) throw new ReadFailure("too_large");
      await noticed.noteFailure(message, async () => messages.push(await this.made(message, product)));
      if (timer.isDue()) await pause();
    }
    return { messages, untilNs: span.toNs, damaged: noticed.parts };
  }

  /** The numeric fields of the topic's first message that can be read. */
  async fields(topic: string): Promise<OfferedFields> {
    const span = this.span(topic);
    const noticed = new Damages(span.fromNs);
    for await (const message of this.recording.messages([topic], span, "forward", noticed.note)) {
      const value = this.decodeOrNote(message, noticed);
      if (value !== null) return { fields: fieldTree(value) };
      if (noticed.parts.length >= MAX_DAMAGED) break;
    }
    throw noticed.first ?? new ReadFailure("topic_silent");
  }

  /** Curves of fields against seconds since the start of the recording, as far as `maxBytes` reach. */
  async curves(request: CurvesRequest, { pause, onCurves }: Pick<Observer, "pause" | "onCurves">): Promise<DrawnCurves> {
    const whole = this.span(request.topic);
    const requested = { fromNs: request.fromNs, toNs: request.toNs };
    const pieces = this.recording.pieces([request.topic], requested);
    const span = affordable(requested, pieces, request.maxBytes);
    const reading = new CurveReading(request, whole, span);
    const noticed = new Damages(whole.fromNs, (part) => reading.breakAt(part));
    const bytes = { wholeBytes: cost(pieces), topicBytes: cost(this.recording.pieces([request.topic], whole)) };
    const drawn = (): DrawnCurves => ({ ...reading.curves(), ...bytes, damaged: [...noticed.parts], untilNs: span.toNs });
    if (reading.needsPrevious && span.fromNs > whole.fromNs) await this.beginWithPrevious(reading, request.topic, span.fromNs);
    this.recording.source.ahead = this.isDense(pieces) ? READ_AHEAD : 0;
    const [pausing, reporting] = [new Timer(PAUSE_EVERY_MS), new Timer(REPORT_EVERY_MS)];
    try {
      for await (const message of this.recording.messages([request.topic], span, "forward", noticed.note)) {
        reading.add(message, this.decodeOrNote(message, noticed));
        if (reporting.isDue()) onCurves(drawn());
        if (pausing.isDue()) await pause();
      }
    } finally {
      this.recording.source.ahead = 0;
    }
    const last = drawn();
    if (last.messages === 0 && noticed.first !== null) throw noticed.first;
    return last;
  }

  /** Give a reading the last message before a time, if little reading finds it. */
  private async beginWithPrevious(reading: CurveReading, topic: string, fromNs: bigint): Promise<void> {
    const unnoticed = new Damages(fromNs);
    const { message } = await this.search.find(topic, "previous", fromNs, { maxBytes: MAX_PREVIOUS_BYTES, onDamage: unnoticed.note });
    if (message !== null && unnoticed.first === null) reading.begin(message, this.decodeOrNote(message, unnoticed));
  }

  private span(topic: string): Span {
    if (!this.recording.topics.some(({ name }) => name === topic)) throw new ReadFailure("topic_unknown");
    if (this.recording.span === null) throw new ReadFailure("topic_silent");
    return this.recording.span;
  }

  private get search(): MessageSearch {
    const { span } = this.recording;
    if (span === null) throw new ReadFailure("topic_silent");
    this.searchOfAll ??= new MessageSearch(this.recording, span);
    return this.searchOfAll;
  }

  private async made(message: Message, product: ProductName | null, signal?: AbortSignal): Promise<ReadMessage> {
    const { logTimeNs, publishTimeNs, sequence, data } = message;
    return { logTimeNs, publishTimeNs, sequence, sizeBytes: data.length, product: product === null ? null : await this.product(message, product, signal) };
  }

  private product(message: Message, name: ProductName, signal?: AbortSignal): Products[ProductName] | Promise<Products[ProductName]> {
    const { channel: { schema }, data } = message;
    if (name === "picture" && isVideoType(schema.name)) return this.video.picture(message, signal);
    return makers[name](message, () => this.decoder(schema)(data));
  }

  private decodeOrNote(message: Message, noticed: Damages): Value | null {
    const decode = this.decoder(message.channel.schema);
    try {
      return decode(message.data);
    } catch (thrown) {
      if (!(thrown instanceof ReadFailure) || thrown.code !== "message_damaged") throw thrown;
      noticed.note({ fromNs: message.logTimeNs, toNs: message.logTimeNs, failure: thrown });
      return null;
    }
  }

  private decoder(schema: Schema): Decode {
    const known = this.decoders.get(schema) ?? decoderOf(schema);
    this.decoders.set(schema, known);
    return known;
  }

  private isDense(pieces: readonly Piece[]): boolean {
    const [first] = pieces;
    const last = pieces.at(-1);
    const whole = this.recording.span;
    if (first === undefined || last === undefined || whole === null) return false;
    const share = Number(last.toNs - first.fromNs) / Math.max(1, Number(whole.toNs - whole.fromNs));
    return cost(pieces) > DENSE * share * this.recording.source.sizeBytes;
  }
}

/** What could not be read while one question was answered, in seconds since the recording's start. */
class Damages {
  readonly parts: DamagedPart[] = [];
  first: ReadFailure | null = null;

  constructor(
    private readonly startNs: bigint,
    private readonly onPart: (part: DamagedPart) => void = () => undefined,
  ) {}

  readonly note: OnDamage = ({ fromNs, toNs, failure }) => {
    this.first ??= failure;
    const [fromSeconds, toSeconds] = [fromNs, toNs].map((timeNs) => Number(timeNs - this.startNs) / SECOND_NS) as [number, number];
    const part = { fromSeconds, toSeconds };
    // A search comes to a part again, each time with more of what is around it.
    if (this.parts.some((known) => known.fromSeconds === fromSeconds && known.toSeconds === toSeconds)) return;
    this.onPart(part);
    if (this.parts.length < MAX_DAMAGED) this.parts.push(part);
  };

  /** Do something with a message; where the message is damaged, note it. */
  async noteFailure({ logTimeNs }: Message, act: () => Promise<unknown>): Promise<void> {
    try {
      await act();
    } catch (thrown) {
      if (!(thrown instanceof ReadFailure) || thrown.code !== "message_damaged") throw thrown;
      this.note({ fromNs: logTimeNs, toNs: logTimeNs, failure: thrown });
    }
  }
}

/** Says when some time has passed since it last did. */
class Timer {
  private last = Date.now();

  constructor(private readonly everyMs: number) {}

  isDue(): boolean {
    const isDue = Date.now() - this.last >= this.everyMs;
    if (isDue) this.last = Date.now();
    return isDue;
  }
}

/** The beginning of the span that fits into `maxBytes`: at least one piece. */
function affordable(span: Span, pieces: readonly Piece[], maxBytes: number): Span {
  let bytes = 0;
  for (const [number, piece] of pieces.entries()) {
    bytes += piece.bytes;
    if (bytes > maxBytes && number > 0 && piece.fromNs > span.fromNs) return { fromNs: span.fromNs, toNs: piece.fromNs - 1n };
  }
  return span;
}

/** Lets what arrived in the meantime be handled, such as a cancellation. */
export function yieldToEvents(): Promise<void> {
  return new Promise((resolve) => setTimeout(resolve));
}
