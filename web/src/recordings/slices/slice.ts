/** Writes a slice of a recording as MCAP: the bytes that `write_slice` in recordings/writing/mcap.py makes.
 *
 * Only whole recordings with a true index are sliced here: of a damaged one, `klein cut` saves what can be read, and
 * says what is lost; it also corrects a wrong index. Memory: the messages that are being merged, one chunk, and the records of the summary.
 */

import { ReadFailure, type FailureCode } from "../failures";
import type { Channel, Message, Recording, Span } from "../formats/recording";
import { READ_AHEAD } from "../limits";
import { yieldToEvents } from "../session";
import { checkEmptySelection, checkTime } from "./index_check";
import { latchedBefore, sameChannel } from "./latched";
import { McapWriter, type Compression } from "./mcap_writer";

export interface SliceRequest {
  /** Null: all. */
  topics: readonly string[] | null;
  /** Inclusive; null: from the first message. */
  startNs: bigint | null;
  /** Exclusive; null: to the last message. */
  endNs: bigint | null;
  /** Name and checksum of the file, for the record of what the slice was made from. */
  fileName: string;
  sha256: string | null;
  /** Of Kleinkram. */
  version: string;
}

export interface SliceResult {
  messages: number;
  /** Messages of latched topics from before the start, among `messages`. */
  latched: number;
  bytes: number;
}

export interface SliceOutput {
  compression: Compression;
  /** Takes the next bytes; the writer waits for it. */
  write: (bytes: Uint8Array) => Promise<void>;
  /** The share that is done, from 0 to 1, and the bytes that were written. */
  onProgress: (share: number, bytes: number) => void;
  signal: AbortSignal;
}

const MADE_FROM = "kleinkram:made_from";
const PROFILES: Readonly<Record<string, string>> = { ros1: "ros1", cdr: "ros2" };
const WRITE_BYTES = 2 ** 20;
const END_OF_TIME = 2n ** 64n;
/** Failures that are not those of the network, but of the recording. */
const REFUSED: Readonly<Partial<Record<FailureCode, string>>> = {
  chunk_damaged: "a part of it is damaged",
  index_damaged: "its index is damaged",
  too_large: "a part of it is too large",
};

/** @throws ReadFailure not_sliceable, range_outside, cancelled, and what requests to the store throw. */
export async function writeSlice(recording: Recording, request: SliceRequest, output: SliceOutput): Promise<SliceResult> {
  try {
    return await copySlice(recording, request, output);
  } catch (thrown) {
    const failure = thrown instanceof RangeError ? new ReadFailure("chunk_damaged", thrown.message) : thrown;
    const reason = failure instanceof ReadFailure ? REFUSED[failure.code] : undefined;
    throw reason === undefined ? failure : new ReadFailure("not_sliceable", reason);
  }
}

async function copySlice(recording: Recording, request: SliceRequest, output: SliceOutput): Promise<SliceResult> {
  const topics = request.topics ?? recording.topics.map(({ name }) => name);
  const channels = recording.channels.filter(({ topic }) => topics.includes(topic));
  checkSliceable(recording, topics, channels);
  const span = spanOf(recording, request);
  const startNs = request.startNs ?? 0n;
  const pending: Uint8Array[] = [];
  const names = { profile: profileOf(recording, channels), library: `kleinkram ${request.version}` };
  const writer = new McapWriter((bytes) => pending.push(bytes), names, output.compression);
  const drain = drainTo(output, pending);
  const defined = new DefinedChannels(writer);
  const latched = startNs > 0n ? await latchedBefore(recording, topics, startNs) : [];
  for (const message of latched) writer.addMessage({ ...message, channelId: defined.idOf(message.channel), logTimeNs: startNs });
  const messages = latched.length + (await copyMessages(recording, topics, span, { writer, defined, drain, output }));
  for (const channel of channels) defined.idOf(channel);
  await copyOtherRecords(recording, writer, drain);
  writer.addMetadata(MADE_FROM, madeFrom(request, topics, latched));
  writer.finish();
  await drain(0);
  return { messages, latched: latched.length, bytes: writer.bytesWritten };
}

function checkSliceable(recording: Recording, topics: readonly string[], channels: readonly Channel[]): void {
  const known = new Set(recording.topics.map(({ name }) => name));
  const unknown = topics.find((topic) => !known.has(topic));
  if (unknown !== undefined) throw new ReadFailure("topic_unknown", unknown);
  if (recording.indexedUntil !== null) throw new ReadFailure("not_sliceable", "it was not closed and has no index");
  if (recording.isIndexContradictory) throw new ReadFailure("not_sliceable", "its index contradicts itself");
  const undefinedOne = channels.find(({ schema }) => isUndefined(schema));
  if (undefinedOne !== undefined) {
    throw new ReadFailure("not_sliceable", `it lacks the message definition of ${undefinedOne.topic}`);
  }
}

/** Whether the definition of a type is missing that `klein cut` may know. */
function isUndefined({ encoding, definition, messageEncoding }: Channel["schema"]): boolean {
  return encoding === "" && messageEncoding === "cdr" && new TextDecoder().decode(definition).trim() === "";
}

function spanOf({ span }: Recording, { startNs, endNs }: SliceRequest): Span {
  const requested = { fromNs: startNs ?? 0n, toNs: (endNs ?? END_OF_TIME) - 1n };
  const hasRange = startNs !== null || endNs !== null;
  const isOutside = span === null || requested.fromNs > span.toNs || requested.toNs < span.fromNs || requested.toNs < requested.fromNs;
  if (hasRange && isOutside) throw new ReadFailure("range_outside");
  return requested;
}

/** The profile of the recording; where it has none, that of its messages. */
function profileOf(recording: Recording, channels: readonly Channel[]): string {
  if (recording.profile !== "") return recording.profile;
  const profiles = new Set(channels.map(({ schema }) => PROFILES[schema.messageEncoding] ?? ""));
  return profiles.size === 1 ? ([...profiles][0] ?? "") : "";
}

type Drain = (atLeast: number) => Promise<void>;

/** Returns a function that writes what is pending, once that is `atLeast` bytes. */
function drainTo({ write }: SliceOutput, pending: Uint8Array[]): Drain {
  let counted = 0;
  let bytes = 0;
  return async (atLeast) => {
    for (; counted < pending.length; counted++) bytes += pending[counted]?.length ?? 0;
    if (bytes < atLeast) return;
    const whole = new Uint8Array(bytes);
    let at = 0;
    for (const part of pending.splice(0)) {
      whole.set(part, at);
      at += part.length;
    }
    counted = bytes = 0;
    if (whole.length > 0) await write(whole);
  };
}

/** The channels of the slice. Equal channels become one. */
class DefinedChannels {
  private readonly ids = new Map<Channel, number>();

  constructor(private readonly writer: McapWriter) {}

  idOf(channel: Channel): number {
    const known = this.ids.get(channel) ?? this.idOfEqual(channel);
    if (known !== undefined) return known;
    const { topic, schema, properties } = channel;
    const isEmpty = schema.name === "" && schema.encoding === "" && schema.definition.length === 0;
    const schemaId = isEmpty ? 0 : this.writer.addSchema({ name: schema.name, encoding: schema.encoding, data: schema.definition });
    const id = this.writer.addChannel(topic, schemaId, schema.messageEncoding, properties);
    this.ids.set(channel, id);
    return id;
  }

  private idOfEqual(channel: Channel): number | undefined {
    const equal = [...this.ids].find(([other]) => sameChannel(other, channel));
    if (equal === undefined) return undefined;
    this.ids.set(channel, equal[1]);
    return equal[1];
  }
}

interface Copying {
  writer: McapWriter;
  defined: DefinedChannels;
  drain: Drain;
  output: SliceOutput;
}

/** Returns how many messages there are. */
async function copyMessages(recording: Recording, topics: readonly string[], span: Span, { writer, defined, drain, output }: Copying): Promise<number> {
  const shareOf = shareWithin(recording, span);
  const pieces = recording.pieces(topics, span);
  if (pieces.length === 0) await checkEmptySelection(recording);
  const isDense = pieces.length > 1 && pieces.every(({ at, bytes }, number) => number === 0 || at <= (pieces[number - 1]?.at ?? 0) + bytes + READ_AHEAD);
  recording.source.ahead = isDense ? READ_AHEAD : 0;
  let count = 0;
  let written = 0;
  try {
    for await (const message of recording.messages(topics, span, "forward", ({ failure }) => { throw failure; })) {
      checkTime(message);
      writer.addMessage({ ...message, channelId: defined.idOf(message.channel) });
      count += 1;
      if (writer.bytesWritten - written < WRITE_BYTES) continue;
      written = writer.bytesWritten;
      await drain(WRITE_BYTES);
      output.onProgress(shareOf(message), written);
      await yieldToEvents();
      if (output.signal.aborted) throw new ReadFailure("cancelled");
    }
  } finally {
    recording.source.ahead = 0;
  }
  return count;
}

function shareWithin(recording: Recording, span: Span): (message: Message) => number {
  const from = recording.span !== null && recording.span.fromNs > span.fromNs ? recording.span.fromNs : span.fromNs;
  const to = recording.span !== null && recording.span.toNs < span.toNs ? recording.span.toNs : span.toNs;
  const whole = Math.max(1, Number(to - from));
  return ({ logTimeNs }) => Math.min(1, Math.max(0, Number(logTimeNs - from) / whole));
}

async function copyOtherRecords(recording: Recording, writer: McapWriter, drain: Drain): Promise<void> {
  for await (const { op, at, length, indexFields } of recording.otherRecords()) {
    writer.beginCopy(op, length, indexFields);
    for (let place = at; place < at + length; place += READ_AHEAD) {
      writer.copy(await recording.source.read(place, Math.min(READ_AHEAD, at + length - place)));
      await drain(WRITE_BYTES);
    }
  }
}

function madeFrom(request: SliceRequest, topics: readonly string[], latched: readonly Message[]): [string, string][] {
  const { version, fileName, sha256, startNs, endNs } = request;
  const entries: [string, string][] = [["version", version], ["files", pythonJson([{ name: fileName, ...(sha256 !== null && { sha256 }) }])]];
  if (request.topics !== null) entries.push(["topics", pythonJson([...new Set(topics)].sort())]);
  if (startNs !== null && startNs > 0n) entries.push(["start_ns", String(startNs)]);
  if (endNs !== null) entries.push(["end_ns", String(endNs)]);
  const times: Record<string, bigint[]> = {};
  for (const { channel, logTimeNs } of latched) (times[channel.topic] ??= []).push(logTimeNs);
  if (latched.length > 0) entries.push(["latched", pythonJson(times)]);
  return entries;
}

type Json = string | bigint | readonly Json[] | { readonly [name: string]: Json };

/** JSON as Python's `json.dumps` writes it. */
export function pythonJson(value: Json): string {
  if (typeof value === "bigint") return String(value);
  if (typeof value === "string") {
    return JSON.stringify(value).replace(/[\u007f-\uffff]/g, (unit) => `\\u${unit.charCodeAt(0).toString(16).padStart(4, "0")}`);
  }
  if (Array.isArray(value)) return `[${value.map(pythonJson).join(", ")}]`;
  return `{${Object.entries(value as Record<string, Json>).map(([name, item]) => `${pythonJson(name)}: ${pythonJson(item)}`).join(", ")}}`;
}
