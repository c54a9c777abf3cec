/** PX4 flight logs (ULog): one pass finds topics, and the parts of the file with the times and topics of their messages.
 *
 * Times are those of the autopilot's clock, which starts at boot. A message that was published before the log began has
 * the time of the beginning. A file has no index and no checksum: behind damage, reading continues at the next sync
 * message. Source: docs.px4.io, ULog File Format (version 1); the same rules as `recordings/formats/ulog.py`.
 */

import { definitionOf, stampOffset } from "../decoding/ulog_definition";
import { ReadFailure } from "../failures";
import { MAX_DAMAGED, MAX_DEFINITION, READ_AHEAD } from "../limits";
import type { Source } from "../ranges";
import { inOrder, type Channel, type ChunkContent, type Damage, type Message, type OnDamage, type Order, type OtherRecord, type Piece, type RecordedTopic, type Recording, type Span } from "./recording";

const MAGIC = Uint8Array.of(0x55, 0x4c, 0x6f, 0x67, 0x01, 0x12, 0x35);
const SYNC = Uint8Array.of(0x08, 0x00, 0x53, 0x2f, 0x73, 0x13, 0x20, 0x25, 0x0c, 0xbb, 0x12);
const HEADER_BYTES = 16;
const HEAD_BYTES = 3;
const MAX_MESSAGE = HEAD_BYTES + 0xffff;
const PART_BYTES = 256 * 1024;
const MAX_TOPICS = 10_000;
const MAX_NAME = 1024;
const NS_PER_US = 1000n;
const LATEST_US = ((1n << 63n) - 1n) / NS_PER_US;
const FLAG_BYTES = 40;
const Kind = { addLogged: 0x41, flagBits: 0x42, data: 0x44, format: 0x46 } as const;
const KINDS: ReadonlySet<number> = new Set(Array.from("ABCDFILMOPQRS", (letter) => letter.charCodeAt(0)));
const TEXT = new TextDecoder();

interface Subscription {
  channel: Channel;
  /** Offset of the timestamp in the data; null: it has none. */
  stampAt: number | null;
}

/** Messages that follow each other in the file. */
interface Part extends Piece {
  topics: ReadonlySet<string>;
}

interface UlogScan {
  startUs: bigint;
  subscriptions: ReadonlyMap<number, Subscription>;
  parts: readonly Part[];
  damages: readonly Damage[];
  /** Where reading ended. */
  until: number;
}

/** Open a log by reading up to `maxBytes` of it.
 *
 * @throws ReadFailure not_readable_here, where it is no log, or one of a later version.
 */
export async function openUlog(source: Source, maxBytes: number): Promise<Recording> {
  const header = await source.read(0, Math.min(HEADER_BYTES, source.sizeBytes));
  if (header.length < HEADER_BYTES || MAGIC.some((byte, at) => header[at] !== byte)) throw new ReadFailure("not_readable_here");
  const startUs = viewOf(header).getBigUint64(8, true);
  const scanner = new UlogScanner(source, startUs <= LATEST_US ? startUs : 0n, Math.min(source.sizeBytes, Math.max(maxBytes, HEADER_BYTES)));
  source.ahead = READ_AHEAD;
  try {
    return new UlogRecording(source, await scanner.run());
  } finally {
    source.ahead = 0;
  }
}

function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

/** Returns the time of a data message whose body begins at `at`; null where it has none that can be read. */
function stampOf(view: DataView, at: number, size: number, { stampAt }: Subscription): bigint | null {
  if (stampAt === null || 2 + stampAt + 8 > size) return null;
  const stampUs = view.getBigUint64(at + 2 + stampAt, true);
  return stampUs <= LATEST_US ? stampUs : null;
}

/** What a run of whole messages ended with. */
interface Run {
  end: number;
  isDamaged: boolean;
}

class UlogScanner {
  private readonly formats = new Map<string, string>();
  private formatBytes = 0;
  private readonly subscriptions = new Map<number, Subscription>();
  private readonly parts: Part[] = [];
  private readonly damages: Damage[] = [];
  private appended: readonly number[] = [];
  private lastNs: bigint;
  private partSpan: Span | null = null;
  private partTopics = new Set<string>();

  constructor(
    private readonly source: Source,
    private readonly startUs: bigint,
    private readonly until: number,
  ) {
    this.lastNs = startUs * NS_PER_US;
  }

  async run(): Promise<UlogScan> {
    let at = HEADER_BYTES;
    while (at < this.until) at = await this.step(at);
    return { startUs: this.startUs, subscriptions: this.subscriptions, parts: this.parts, damages: this.damages, until: this.until };
  }

  /** Read the next part of the file, or pass over damage; returns where to continue. */
  private async step(at: number): Promise<number> {
    const boundary = this.appended.filter((offset) => offset > at && offset <= this.until).reduce((least, offset) => Math.min(least, offset), this.until);
    const window = await this.source.read(at, Math.min(PART_BYTES + MAX_MESSAGE, boundary - at));
    const { end, isDamaged } = this.readMessages(window);
    if (this.partSpan !== null) this.parts.push({ ...this.partSpan, at, bytes: end, topics: this.partTopics });
    this.partSpan = null;
    this.partTopics = new Set();
    if (isDamaged) return this.resync(at + end, boundary);
    // Data that were appended cut the last message before them, as does the end of the file.
    const isCut = end === 0 || (at + window.length === boundary && end + HEAD_BYTES > window.length);
    return isCut ? boundary : at + end;
  }

  private readMessages(window: Uint8Array): Run {
    const view = viewOf(window);
    let at = 0;
    while (at + HEAD_BYTES <= window.length && at < PART_BYTES) {
      const size = view.getUint16(at, true);
      const kind = window[at + 2] ?? 0;
      if (!KINDS.has(kind)) return { end: at, isDamaged: true };
      const after = at + HEAD_BYTES + size;
      if (after > window.length) break;
      if (kind === Kind.data) this.noteData(view, at + HEAD_BYTES, size);
      else this.readOther(kind, window.subarray(at + HEAD_BYTES, after));
      at = after;
      if (kind === Kind.flagBits) break; // it may say where messages end
    }
    return { end: at, isDamaged: false };
  }

  private noteData(view: DataView, at: number, size: number): void {
    const subscription = size >= 2 ? this.subscriptions.get(view.getUint16(at, true)) : undefined;
    const stampUs = subscription === undefined ? null : stampOf(view, at, size, subscription);
    if (subscription === undefined || stampUs === null) return;
    const timeNs = (stampUs > this.startUs ? stampUs : this.startUs) * NS_PER_US;
    this.lastNs = timeNs;
    this.partTopics.add(subscription.channel.topic);
    const { fromNs, toNs } = this.partSpan ?? { fromNs: timeNs, toNs: timeNs };
    this.partSpan = { fromNs: timeNs < fromNs ? timeNs : fromNs, toNs: timeNs > toNs ? timeNs : toNs };
  }

  private readOther(kind: number, body: Uint8Array): void {
    if (kind === Kind.format) this.readFormat(TEXT.decode(body));
    else if (kind === Kind.addLogged && body.length >= 3) this.subscribe(body);
    else if (kind === Kind.flagBits && body.length >= FLAG_BYTES) {
      const [appends = 0, ...others] = body.subarray(8, 16);
      if ((appends & ~1) !== 0 || others.some((flags) => flags !== 0)) throw new ReadFailure("not_readable_here");
      if (appends === 1) this.appended = [16, 24, 32].map((at) => Number(viewOf(body).getBigUint64(at, true))).filter((offset) => offset > 0);
    }
  }

  private readFormat(text: string): void {
    const colon = text.indexOf(":");
    this.formatBytes += text.length;
    if (colon < 0 || this.formats.size >= MAX_TOPICS || this.formatBytes > MAX_DEFINITION) return;
    const name = text.slice(0, Math.min(colon, MAX_NAME));
    if (!this.formats.has(name)) this.formats.set(name, text.slice(colon + 1));
  }

  /** The first topic of a message id counts. Instances other than the first have their number in the name. */
  private subscribe(body: Uint8Array): void {
    const id = viewOf(body).getUint16(1, true);
    if (this.subscriptions.has(id) || this.subscriptions.size >= MAX_TOPICS) return;
    const instance = body[0] ?? 0;
    const name = TEXT.decode(body.subarray(3, 3 + MAX_NAME));
    const definition = new TextEncoder().encode(definitionOf(this.formats, name));
    const schema = { name, encoding: "ulog", messageEncoding: "ulog", definition };
    const channel = { topic: instance > 0 ? `${name}#${instance}` : name, schema, properties: [] };
    this.subscriptions.set(id, { channel, stampAt: stampOffset(this.formats, name) });
  }

  /** Pass over damage; returns where the next sync message begins, or `boundary`. */
  private async resync(start: number, boundary: number): Promise<number> {
    const failure = new ReadFailure("chunk_damaged", `byte ${start}`);
    if (this.damages.length < MAX_DAMAGED) this.damages.push({ fromNs: this.lastNs, toNs: this.lastNs, failure });
    for (let at = start; at < boundary; at += PART_BYTES - SYNC.length) {
      const sync = indexOf(await this.source.read(at, Math.min(PART_BYTES, boundary - at)), SYNC);
      if (sync >= 0) return at + sync;
    }
    return boundary;
  }
}

function indexOf(bytes: Uint8Array, pattern: Uint8Array): number {
  for (let at = bytes.indexOf(pattern[0] ?? 0); at >= 0; at = bytes.indexOf(pattern[0] ?? 0, at + 1)) {
    if (pattern.every((byte, place) => bytes[at + place] === byte)) return at;
  }
  return -1;
}

class UlogRecording implements Recording {
  readonly span: Span | null;
  readonly indexedUntil: number | null;
  readonly topics: readonly RecordedTopic[];
  readonly channels: readonly Channel[];
  readonly profile = "";
  readonly isIndexContradictory = false;

  constructor(
    readonly source: Source,
    private readonly scan: UlogScan,
  ) {
    const { parts, subscriptions, until } = scan;
    const recorded = new Set(parts.flatMap(({ topics }) => [...topics]));
    // The autopilot announces all topics: those count that have messages.
    this.channels = [...subscriptions.values()].map(({ channel }) => channel).filter(({ topic }) => recorded.has(topic));
    this.topics = [...new Map(this.channels.map(({ topic, schema }) => [topic, { name: topic, schema }] as const)).values()];
    this.indexedUntil = until < source.sizeBytes ? until : null;
    this.span = parts.reduce<Span | null>(
      (span, { fromNs, toNs }) => ({ fromNs: span !== null && span.fromNs < fromNs ? span.fromNs : fromNs, toNs: span !== null && span.toNs > toNs ? span.toNs : toNs }),
      null,
    );
  }

  pieces(topics: readonly string[], span: Span): Part[] {
    const inside = this.scan.parts.filter((part) => part.fromNs <= span.toNs && part.toNs >= span.fromNs);
    return inside.filter((part) => topics.some((topic) => part.topics.has(topic))).sort((a, b) => (a.fromNs < b.fromNs ? -1 : a.fromNs > b.fromNs ? 1 : a.at - b.at));
  }

  async *messages(topics: readonly string[], span: Span, order: Order, onDamage: OnDamage): AsyncIterable<Message> {
    for (const damage of this.scan.damages) if (damage.fromNs <= span.toNs && damage.toNs >= span.fromNs) onDamage(damage);
    const names = new Set(topics);
    yield* inOrder(this.pieces(topics, span), (part) => this.read(part, names), { span, order, onDamage });
  }

  async readPiece(piece: Piece, topics: readonly string[]): Promise<readonly Message[]> {
    return (await this.read(piece, new Set(topics))).messages;
  }

  /** A log has none. */
  otherRecords(): AsyncIterable<OtherRecord> {
    return { [Symbol.asyncIterator]: () => ({ next: () => Promise.resolve({ done: true, value: undefined }) }) };
  }

  private async read({ at, bytes, fromNs, toNs }: Piece, topics: ReadonlySet<string>): Promise<ChunkContent> {
    const part = await this.source.read(at, bytes);
    const view = viewOf(part);
    const messages: Message[] = [];
    for (let head = 0; head + HEAD_BYTES <= part.length; ) {
      const size = view.getUint16(head, true);
      const body = head + HEAD_BYTES;
      if (part[head + 2] === Kind.data && size >= 2) {
        const subscription = this.scan.subscriptions.get(view.getUint16(body, true));
        const stampUs = subscription === undefined || !topics.has(subscription.channel.topic) ? null : stampOf(view, body, size, subscription);
        if (subscription !== undefined && stampUs !== null) {
          const logTimeNs = (stampUs > this.scan.startUs ? stampUs : this.scan.startUs) * NS_PER_US;
          const data = part.subarray(body + 2, body + size);
          messages.push({ logTimeNs, publishTimeNs: logTimeNs, sequence: 0, channel: subscription.channel, data, chunkSpan: { fromNs, toNs } });
        }
      }
      head = body + size;
    }
    return { messages, retainedBytes: part.length };
  }
}
