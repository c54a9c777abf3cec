/** Messages of latched topics that are valid when a slice begins: the rules of recordings/writing/latched.py.
 *
 * Of each channel, the last messages before the start, as many as there are publishers; of static transforms, the last
 * message for each child frame.
 */

import { decoderOf } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import type { Channel, Message, Piece, Recording } from "../formats/recording";
import { checkTime } from "./index_check";
import { sameSchema } from "./mcap_writer";

const TRANSIENT_LOCAL = /\bdurability"?:\s*(1|transient_local)\b/gi;
const LATCHED_NAMES: readonly string[] = ["tf_static", "robot_description"];
const STATIC_TRANSFORMS = "tf_static";
/** Pieces that are read for a topic, at most: the first and the last of those that hold it. */
const MAX_PIECES = 64;

interface Collector {
  add(placed: Placed): void;
  /** Whether messages up to a log time cannot be among the last ones. */
  isComplete(lastNs: bigint): boolean;
  messages(): readonly Placed[];
}

/** A message, where its piece begins in the file, and its number in it: what orders messages of equal times. */
interface Placed {
  message: Message;
  at: number;
  number: number;
}

const lastPart = (topic: string): string => topic.slice(topic.lastIndexOf("/") + 1);

/** Whether two channels are one in a slice. */
export function sameChannel(one: Channel, other: Channel): boolean {
  if (one === other) return true;
  const [schema, otherSchema] = [one.schema, other.schema];
  return (
    one.topic === other.topic &&
    schema.messageEncoding === otherSchema.messageEncoding &&
    sameSchema({ ...schema, data: schema.definition }, { ...otherSchema, data: otherSchema.definition }) &&
    JSON.stringify(one.properties) === JSON.stringify(other.properties)
  );
}

/** Returns how many publishers of a channel are latched; 0 for a topic that is not. */
export function publisherCount({ topic, properties }: Channel): number {
  const byName = new Map(properties);
  const profiles = byName.get("offered_qos_profiles")?.match(TRANSIENT_LOCAL)?.length ?? 0;
  return profiles || Number(byName.get("latching") === "1" || LATCHED_NAMES.includes(lastPart(topic)));
}

/** Returns the valid messages of latched topics before `startNs`, by log time. */
export async function latchedBefore(recording: Recording, topics: readonly string[], startNs: bigint): Promise<Message[]> {
  const { span } = recording;
  const collectors = collectorsOf(recording.channels.filter(({ topic }) => topics.includes(topic)));
  if (collectors.size === 0 || span === null || span.fromNs >= startNs) return [];
  const before = recording.pieces([...collectors.keys()], { fromNs: 0n, toNs: startNs - 1n }).filter(({ fromNs }) => fromNs < startNs);
  await readBackwards(recording, before, collectors, startNs);
  return inOrder([...collectors.values()].flatMap((one) => one.messages())).map(({ message }) => message);
}

function collectorsOf(channels: readonly Channel[]): Map<string, Collector> {
  const byTopic = new Map<string, Channel[]>();
  for (const channel of channels) {
    const own = byTopic.get(channel.topic) ?? [];
    if (!own.some((other) => sameChannel(channel, other))) byTopic.set(channel.topic, [...own, channel]);
  }
  const latched = [...byTopic].filter(([, own]) => own.some((channel) => publisherCount(channel) > 0));
  return new Map(latched.map(([topic, own]) => [topic, lastPart(topic) === STATIC_TRANSFORMS ? new LastTransforms() : new LastMessages(own)]));
}

async function readBackwards(recording: Recording, pieces: readonly Piece[], collectors: ReadonlyMap<string, Collector>, startNs: bigint): Promise<void> {
  const latestFirst = pieces.toSorted((a, b) => (a.toNs === b.toNs ? b.at - a.at : a.toNs > b.toNs ? -1 : 1));
  const toRead = new Map([...collectors.keys()].map((topic) => [topic, outermost(latestFirst, topic)]));
  for (const piece of latestFirst) {
    const topics = [...collectors].filter(([topic, one]) => toRead.get(topic)?.has(piece) === true && !one.isComplete(piece.toNs)).map(([topic]) => topic);
    if (topics.length === 0) continue;
    for (const [number, message] of sortedByTime(await recording.readPiece(piece, topics)).entries()) {
      if (message.logTimeNs >= startNs) continue;
      checkTime(message);
      collectors.get(message.channel.topic)?.add({ message, at: piece.at, number });
    }
  }
}

function outermost(pieces: readonly Piece[], topic: string): ReadonlySet<Piece> {
  const holding = pieces.filter(({ topics }) => topics?.has(topic) ?? true);
  const half = MAX_PIECES / 2;
  return new Set(holding.length <= MAX_PIECES ? holding : [...holding.slice(0, half), ...holding.slice(-half)]);
}

function sortedByTime(messages: readonly Message[]): Message[] {
  return messages.toSorted((a, b) => (a.logTimeNs === b.logTimeNs ? 0 : a.logTimeNs < b.logTimeNs ? -1 : 1));
}

function inOrder(placed: readonly Placed[]): Placed[] {
  return placed.toSorted((a, b) => (isBefore(a, b) ? -1 : isBefore(b, a) ? 1 : 0));
}

function isBefore(one: Placed, other: Placed): boolean {
  const [time, otherTime] = [one.message.logTimeNs, other.message.logTimeNs];
  if (time !== otherTime) return time < otherTime;
  return one.at === other.at ? one.number < other.number : one.at < other.at;
}

/** The last messages of each channel of a topic. */
class LastMessages implements Collector {
  private readonly channels: { channel: Channel; last: Placed[] }[] = [];
  private readonly count: number;

  constructor(private readonly known: readonly Channel[]) {
    this.count = Math.max(...known.map(publisherCount));
  }

  add(placed: Placed): void {
    const own = copied(placed);
    const { channel } = placed.message;
    const known = this.channels.find((one) => sameChannel(one.channel, channel));
    if (known === undefined) this.channels.push({ channel, last: [own] });
    else known.last = inOrder([...known.last, own]).slice(-this.count);
  }

  isComplete(lastNs: bigint): boolean {
    const isLate = ({ last }: { last: Placed[] }): boolean => last.length === this.count && (last[0]?.message.logTimeNs ?? 0n) >= lastNs;
    return this.channels.length === this.known.length && this.channels.every(isLate);
  }

  messages(): readonly Placed[] {
    return this.channels.flatMap(({ last }) => last);
  }
}

/** The last message for each child frame. */
class LastTransforms implements Collector {
  private readonly byFrame = new Map<string, Placed>();

  add(placed: Placed): void {
    const own = copied(placed);
    for (const frame of childFrames(placed.message)) {
      const known = this.byFrame.get(frame);
      if (known === undefined || isBefore(known, own)) this.byFrame.set(frame, own);
    }
  }

  isComplete(): boolean {
    return false; // any earlier message may have another frame
  }

  messages(): readonly Placed[] {
    return [...new Set(this.byFrame.values())];
  }
}

/** A copy that does not keep its chunk in memory. */
function copied({ message, ...place }: Placed): Placed {
  return { ...place, message: { ...message, data: message.data.slice() } };
}

function childFrames({ channel, data }: Message): string[] {
  try {
    const { transforms } = decoderOf(channel.schema)(data) as { transforms?: unknown };
    if (!Array.isArray(transforms)) return [""];
    return transforms.map((transform: { child_frame_id?: unknown }) => (typeof transform.child_frame_id === "string" ? transform.child_frame_id : ""));
  } catch (thrown) {
    if (!(thrown instanceof ReadFailure)) throw thrown;
    return [""];
  }
}
