/** Finds single messages of a topic by time. Remembers the latest result for each topic, because playing goes forward. */

import type { Message, OnDamage, Order, Recording, Span } from "./formats/recording";
import type { Which } from "./products/products";

export interface Search {
  message: Message | null;
  /** How far it was searched, where the byte limit ended the search; else null. */
  searchedToNs: bigint | null;
}

/** The message that is valid at a time: none is between it and `atNs`. */
interface Latest extends Search {
  atNs: bigint;
}

/** The first part of a span that is searched; each further one is twice as long. */
const FIRST_NS = 250_000_000n;
/** A recording without index of which less was read ends later than is known. */
const WHOLE_SHARE = 0.9;
const NONE: Search = { message: null, searchedToNs: null };

export class MessageSearch {
  private readonly latest = new Map<string, Latest>();

  constructor(
    private readonly recording: Recording,
    private readonly span: Span,
  ) {}

  /** Find a message of a topic.
   *
   * `valid`: the last at or before `atNs`. `next` and `previous`: the first after it, the last before it. `nearest`: the
   * first at or after it; the last before it where there is none. Reads about `maxBytes` at most, and then says how far.
   */
  async find(topic: string, which: Which, atNs: bigint, { maxBytes, onDamage }: { maxBytes: number; onDamage: OnDamage }): Promise<Search> {
    const search = (span: Span, order: Order): Promise<Search> => this.search(topic, span, order, maxBytes, onDamage);
    const { fromNs, toNs } = this.span;
    if (atNs > toNs && this.isBeginning && (which === "valid" || which === "next")) return { message: null, searchedToNs: toNs };
    if (which === "valid") return this.valid(topic, atNs, search);
    if (which === "next") return search({ fromNs: atNs + 1n, toNs }, "forward");
    if (which === "previous") return search({ fromNs, toNs: atNs - 1n }, "backward");
    const after = await search({ fromNs: atNs, toNs }, "forward");
    return after.message === null ? search({ fromNs, toNs: atNs - 1n }, "backward") : after;
  }

  /** Whether only the beginning of the recording was seen. */
  private get isBeginning(): boolean {
    const { indexedUntil, source } = this.recording;
    return indexedUntil !== null && indexedUntil < WHOLE_SHARE * source.sizeBytes;
  }

  private async valid(topic: string, atNs: bigint, search: (span: Span, order: Order) => Promise<Search>): Promise<Search> {
    const known = this.latest.get(topic);
    if (known !== undefined && atNs <= known.atNs && known.message !== null && known.message.logTimeNs <= atNs) return known;
    const before = known !== undefined && known.atNs < atNs ? known : null;
    const between = await search({ fromNs: before === null ? this.span.fromNs : before.atNs + 1n, toNs: atNs }, "backward");
    const isAnswer = between.message !== null || between.searchedToNs !== null || before === null;
    const { message, searchedToNs } = isAnswer ? between : before;
    // A copy, so that the chunk can leave the memory.
    const copied = message === null || message === before?.message ? message : { ...message, data: message.data.slice() };
    this.latest.set(topic, { atNs, message: copied, searchedToNs });
    return { message: copied, searchedToNs };
  }

  private async search(topic: string, span: Span, order: Order, maxBytes: number, onDamage: OnDamage): Promise<Search> {
    const { source } = this.recording;
    const startBytes = source.bytesRead;
    const within = { fromNs: max(span.fromNs, this.span.fromNs), toNs: min(span.toNs, this.span.toNs) };
    for (const part of parts(within, order)) {
      for await (const message of this.recording.messages([topic], part, order, onDamage)) return { message, searchedToNs: null };
      const reached = order === "forward" ? part.toNs : part.fromNs;
      if (source.bytesRead - startBytes > maxBytes) return { message: null, searchedToNs: reached };
    }
    return NONE;
  }
}

/** Divide a span into parts, short ones first, so that a message that is near is found without reading far. */
function* parts({ fromNs, toNs }: Span, order: Order): Iterable<Span> {
  let length = FIRST_NS;
  for (let [from, to] = [fromNs, toNs]; from <= to; length *= 2n) {
    const part: Span = order === "forward" ? { fromNs: from, toNs: min(to, from + length) } : { fromNs: max(from, to - length), toNs: to };
    yield part;
    if (order === "forward") from = part.toNs + 1n;
    else to = part.fromNs - 1n;
  }
}

function min(a: bigint, b: bigint): bigint {
  return a < b ? a : b;
}

function max(a: bigint, b: bigint): bigint {
  return a > b ? a : b;
}
