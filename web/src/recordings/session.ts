/** One opened recording: answers the page's questions, one after the other. Runs in the worker; knows no messages. */

import { CurveCollector } from "./curves/curves";
import { decoderOf } from "./decoding/decoder";
import { fieldTree, numberAt, stepsOf } from "./decoding/fields";
import type { Decode } from "./decoding/value";
import { ReadFailure } from "./failures";
import { cost } from "./formats/recording";
import type { Message, Piece, Recording, Schema, Span } from "./formats/recording";
import { READ_AHEAD } from "./limits";
import { pictureOf } from "./pictures/picture";
import type { Picture } from "./pictures/picture";
import type { CurvesRequest, DrawnCurves, OfferedFields, Opened, PictureRequest } from "./protocol";

export interface FoundPicture {
  logTimeNs: bigint;
  picture: Picture;
}

/** What a long reading tells, and how it is ended. */
export interface Listener {
  signal: AbortSignal;
  onCurves: (curves: DrawnCurves) => void;
}

const TELL_EVERY_MS = 400;
const SECOND_NS = 1e9;
/** Where the pieces that are wanted are most of what lies between them, reading ahead saves requests. */
const DENSE = 0.5;

export class Session {
  private readonly decoders = new Map<Schema, Decode>();

  constructor(private readonly recording: Recording) {}

  opened(): Opened {
    const topics = this.recording.topics.map(({ name, schema }) => ({ name, messageType: schema.name }));
    const { span, mendedUntil } = this.recording;
    return { span, mendedUntil, topics };
  }

  /** @throws ReadFailure topic_silent, not_a_picture, and whatever reading may. */
  async picture({ topic, atNs, step }: PictureRequest): Promise<FoundPicture> {
    const span = this.span(topic);
    const after = { fromNs: step === "next" ? atNs + 1n : atNs, toNs: span.toNs };
    const before = { fromNs: span.fromNs, toNs: step === "previous" ? atNs - 1n : atNs };
    const message =
      step === "previous"
        ? ((await this.first(topic, before, "backward")) ?? (await this.first(topic, span, "forward")))
        : ((await this.first(topic, after, "forward")) ?? (await this.first(topic, span, "backward")));
    if (message === null) throw new ReadFailure("topic_silent");
    return { logTimeNs: message.logTimeNs, picture: pictureOf(this.decoder(message.schema)(message.data)) };
  }

  /** The numeric fields of the topic's first message. */
  async fields(topic: string): Promise<OfferedFields> {
    const message = await this.first(topic, this.span(topic), "forward");
    if (message === null) throw new ReadFailure("topic_silent");
    return { fields: fieldTree(this.decoder(message.schema)(message.data)) };
  }

  /** Curves of fields against seconds since the start of the recording, as far as `mostBytes` reach. */
  async curves(request: CurvesRequest, { signal, onCurves }: Listener): Promise<DrawnCurves> {
    const start = this.span(request.topic).fromNs;
    const asked = { fromNs: request.fromNs, toNs: request.toNs };
    const pieces = this.recording.pieces(request.topic, asked);
    const span = affordable(asked, pieces, request.mostBytes);
    const paths = request.fields.map((field) => stepsOf(field) ?? []);
    const seconds = (timeNs: bigint): number => Number(timeNs - start) / SECOND_NS;
    const collector = new CurveCollector(paths.length, seconds(span.fromNs), seconds(span.toNs));
    const drawn = (): DrawnCurves => ({ ...collector.curves(), wholeBytes: cost(pieces), untilNs: span.toNs });
    this.recording.source.ahead = this.isDense(pieces) ? READ_AHEAD : 0;
    let told = Date.now();
    try {
      for await (const message of this.recording.messages(request.topic, span, "forward")) {
        const value = this.decoder(message.schema)(message.data);
        collector.add(seconds(message.logTimeNs), paths.map((path) => numberAt(value, path)));
        if (Date.now() - told < TELL_EVERY_MS) continue;
        onCurves(drawn());
        await breath(); // lets a cancellation in
        if (signal.aborted) throw new ReadFailure("cancelled");
        told = Date.now();
      }
    } finally {
      this.recording.source.ahead = 0;
    }
    return drawn();
  }

  private span(topic: string): Span {
    if (!this.recording.topics.some(({ name }) => name === topic)) throw new ReadFailure("topic_unknown");
    if (this.recording.span === null) throw new ReadFailure("topic_silent");
    return this.recording.span;
  }

  private async first(topic: string, span: Span, order: "forward" | "backward"): Promise<Message | null> {
    for await (const message of this.recording.messages(topic, span, order)) return message;
    return null;
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

/** The beginning of the span that can be read with so many bytes: at least one piece. */
function affordable(span: Span, pieces: readonly Piece[], mostBytes: number): Span {
  let bytes = 0;
  for (const [number, piece] of pieces.entries()) {
    bytes += piece.bytes;
    if (bytes > mostBytes && number > 0 && piece.fromNs > span.fromNs) return { fromNs: span.fromNs, toNs: piece.fromNs - 1n };
  }
  return span;
}

function breath(): Promise<void> {
  return new Promise((resolve) => setTimeout(resolve));
}
