/** Makes the curves of one request from the messages that are read for it. */

import { CurveCollector, type Curves } from "./curves";
import { derivationOf } from "./derivation_text";
import { evaluatorOf, type Evaluate } from "./derivations";
import { Stamps } from "./stamps";
import type { Value } from "../decoding/decoder";
import type { Message, Span } from "../formats/recording";
import { MAX_DAMAGED } from "../limits";
import type { CurvesRequest, DamagedPart } from "../protocol";

const SECOND_NS = 1e9;

export class CurveReading {
  /** Whether the first value needs the message before it. */
  readonly needsPrevious: boolean;
  private readonly evaluators: readonly Evaluate[];
  private readonly collector: CurveCollector;
  private readonly stamps: Stamps | null;
  private unstamped = 0;
  /** Damaged parts that a later message may have before it. */
  private damaged: DamagedPart[] = [];
  private previousLogSeconds = -Infinity;

  /** `whole` is that of the recording, whose start the seconds count from; `span` is what is read. */
  constructor({ fields, time }: Pick<CurvesRequest, "fields" | "time">, private readonly whole: Span, span: Span) {
    this.needsPrevious = fields.some((field) => derivationOf(field)?.name === "derivative");
    this.evaluators = fields.map(evaluatorOf);
    this.collector = new CurveCollector(fields.length, this.seconds(span.fromNs), this.seconds(span.toNs));
    this.stamps = time === "header" ? new Stamps(whole) : null;
  }

  /** Note the message before the first, which is not drawn. */
  begin(message: Message, value: Value | null): void {
    this.evaluate(this.stampOf(message, value) ?? message.logTimeNs, value);
    this.previousLogSeconds = this.seconds(message.logTimeNs);
  }

  /** Add a message; `value` is null where it is damaged. */
  add(message: Message, value: Value | null): void {
    const stampNs = this.stampOf(message, value);
    const timeNs = stampNs ?? message.logTimeNs;
    const logSeconds = this.seconds(message.logTimeNs);
    if (this.stamps !== null && stampNs === null) this.unstamped += 1;
    if (this.isDamagedBefore(logSeconds)) this.evaluate(timeNs, null); // derivatives forget the message before the part
    this.collector.add(this.seconds(timeNs), this.evaluate(timeNs, value), logSeconds);
  }

  /** Break the curves where messages could not be read. To be called before those behind it are added. */
  breakAt({ fromSeconds, toSeconds }: DamagedPart): void {
    this.collector.breakAt((fromSeconds + toSeconds) / 2);
    // Beyond the limit, parts are joined.
    const [last] = this.damaged.splice(MAX_DAMAGED - 1);
    this.damaged.push({ fromSeconds: Math.min(fromSeconds, last?.fromSeconds ?? Infinity), toSeconds: Math.max(toSeconds, last?.toSeconds ?? -Infinity) });
  }

  /** What there is so far, and how many messages have log times because their stamps cannot be used. */
  curves(): Curves & { unstamped: number } {
    return { ...this.collector.curves(), unstamped: this.unstamped };
  }

  /** Whether a part between the previous message and this one could not be read. */
  private isDamagedBefore(logSeconds: number): boolean {
    const previous = this.previousLogSeconds;
    this.previousLogSeconds = logSeconds;
    if (this.damaged.length === 0) return false;
    const isDamaged = this.damaged.some(({ fromSeconds, toSeconds }) => fromSeconds < logSeconds && toSeconds >= previous);
    this.damaged = this.damaged.filter(({ toSeconds }) => toSeconds >= logSeconds);
    return isDamaged;
  }

  private stampOf(message: Message, value: Value | null): bigint | null {
    return value === null ? null : (this.stamps?.of(message, value) ?? null);
  }

  private evaluate(timeNs: bigint, value: Value | null): (number | null)[] {
    return this.evaluators.map((evaluate) => evaluate(value, timeNs));
  }

  private seconds(timeNs: bigint): number {
    return Number(timeNs - this.whole.fromNs) / SECOND_NS;
  }
}
