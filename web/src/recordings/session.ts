/** One open recording and the requests that it answers, one at a time. Runs in the worker. */

import { CurveCollector } from "./curves/curves";
import { decoderOf, type Decode, type Value } from "./decoding/decoder";
import { fieldTree, numberAt, stepsOf } from "./decoding/fields";
import { ReadFailure } from "./failures";
import { cost, type Message, type OnDamage, type Order, type Piece, type Recording, type Schema, type Span } from "./formats/recording";
import { MAX_DAMAGED, READ_AHEAD } from "./limits";
import { pictureOf, type Picture } from "./pictures/picture";
import type { CurvesRequest, DamagedPart, DrawnCurves, OfferedFields, Opened, PictureRequest, SliceProgress } from "./protocol";

export interface PictureMessage {
  logTimeNs: bigint;
  picture: Picture;
  /** Unreadable parts between the requested time and this picture. */
  damaged: DamagedPart[];
}

/** Receives curves and progress while something is read; `signal` cancels. */
export interface Observer {
  signal: AbortSignal;
  onCurves: (curves: DrawnCurves) => void;
  onSliced: (progress: SliceProgress) => void;
}

const REPORT_EVERY_MS = 400;
const SECOND_NS = 1e9;
/** Where the pieces that are wanted are most of what lies between them, reading ahead saves requests. */
const DENSE = 0.5;

export class Session {
  private readonly decoders = new Map<Schema, Decode>();

  constructor(readonly recording: Recording) {}

  opened(): Opened {
    const topics = this.recording.topics.map(({ name, schema }) => ({ name, messageType: schema.name }));
    const { span, indexedUntil } = this.recording;
    return { span, indexedUntil, topics };
  }

  /** @throws ReadFailure topic_silent, not_a_picture, and whatever reading may. */
  async picture({ topic, atNs, step }: PictureRequest): Promise<PictureMessage> {
    const span = this.span(topic);
    const noticed = new Damages(span.fromNs);
    const after = { fromNs: step === "next" ? atNs + 1n : atNs, toNs: span.toNs };
    const before = { fromNs: span.fromNs, toNs: step === "previous" ? atNs - 1n : atNs };
    const message =
      step === "previous"
        ? ((await this.first(topic, before, "backward", noticed)) ?? (await this.first(topic, span, "forward", noticed)))
        : ((await this.first(topic, after, "forward", noticed)) ?? (await this.first(topic, span, "backward", noticed)));
    if (message === null) throw noticed.first ?? new ReadFailure("topic_silent");
    const picture = pictureOf(this.decoder(message.channel.schema)(message.data));
    return { logTimeNs: message.logTimeNs, picture, damaged: noticed.parts };
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
  async curves(request: CurvesRequest, { signal, onCurves }: Pick<Observer, "signal" | "onCurves">): Promise<DrawnCurves> {
    const start = this.span(request.topic).fromNs;
    const requested = { fromNs: request.fromNs, toNs: request.toNs };
    const pieces = this.recording.pieces([request.topic], requested);
    const span = affordable(requested, pieces, request.maxBytes);
    const paths = request.fields.map((field) => stepsOf(field) ?? []);
    const seconds = (timeNs: bigint): number => Number(timeNs - start) / SECOND_NS;
    const collector = new CurveCollector(paths.length, seconds(span.fromNs), seconds(span.toNs));
    const noticed = new Damages(start, (part) => collector.breakAt((part.fromSeconds + part.toSeconds) / 2));
    const drawn = (): DrawnCurves => ({ ...collector.curves(), damaged: [...noticed.parts], wholeBytes: cost(pieces), untilNs: span.toNs });
    this.recording.source.ahead = this.isDense(pieces) ? READ_AHEAD : 0;
    let reportedAt = Date.now();
    try {
      for await (const message of this.recording.messages([request.topic], span, "forward", noticed.note)) {
        const value = this.decodeOrNote(message, noticed);
        collector.add(seconds(message.logTimeNs), paths.map((path) => (value === null ? null : numberAt(value, path))));
        if (Date.now() - reportedAt < REPORT_EVERY_MS) continue;
        onCurves(drawn());
        await yieldToEvents();
        if (signal.aborted) throw new ReadFailure("cancelled");
        reportedAt = Date.now();
      }
    } finally {
      this.recording.source.ahead = 0;
    }
    const last = drawn();
    if (last.messages === 0 && noticed.first !== null) throw noticed.first;
    return last;
  }

  private span(topic: string): Span {
    if (!this.recording.topics.some(({ name }) => name === topic)) throw new ReadFailure("topic_unknown");
    if (this.recording.span === null) throw new ReadFailure("topic_silent");
    return this.recording.span;
  }

  private async first(topic: string, span: Span, order: Order, noticed: Damages): Promise<Message | null> {
    for await (const message of this.recording.messages([topic], span, order, noticed.note)) return message;
    return null;
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
    this.onPart(part);
    if (this.parts.length < MAX_DAMAGED) this.parts.push(part);
  };
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
