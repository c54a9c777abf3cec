/** Byte ranges of one stored file over HTTP, with a small cache. Expired URLs are renewed. */

import { ReadFailure } from "./failures";
import { BLOCK, MAX_CACHED, MAX_READ_AT_ONCE, STORE_TIMEOUT_MS } from "./limits";

/** Where to read a file for a while. The URL is a secret: it grants access to the file. */
export interface Address {
  url: string;
  expiresAtMs: number;
}

/** Reads `length` bytes at `offset`. Offsets and lengths are bytes. */
export interface ByteSource {
  readonly sizeBytes: number;
  read(offset: number, length: number): Promise<Uint8Array>;
}

/** A source that reads at least `ahead` bytes at once, for sequential reads. */
export interface Source extends ByteSource {
  ahead: number;
  /** Bytes that were read of the store. */
  readonly bytesRead: number;
}

export interface RangesOptions {
  sizeBytes: number;
  /** Requests a URL; called again after it expired. */
  renew: () => Promise<Address>;
  /** Called as bytes arrive, with their number. */
  onBytes?: (count: number) => void;
  /** Whether the next range is fetched while the last one is used, where ranges are read in order. */
  fetchesNext?: boolean;
  fetch?: typeof fetch;
  now?: () => number;
}

const RENEW_BEFORE_MS = 30_000;
const MAX_AHEAD_MS = 1000;
/** What is fetched without being asked for comes within this time: a more urgent range hardly waits for it. */
const MAX_NEXT_MS = 250;
/** So many ranges side by side are a recording that is read from message to message. */
const LEAST_IN_ORDER = 3;
const EXPIRED = new Set([400, 401, 403]);
/** Pauses before a range is requested again that the network interrupted. */
const REPEAT_AFTER_MS = [250, 1000, 3000];

/** A range that is fetched while the one before it is used. Places are blocks. */
interface NextRange {
  readonly from: number;
  /** Null where that failed: it is fetched again once it is needed, and fails where somebody waits for it. */
  readonly bytes: Promise<Uint8Array | null>;
}

/** A file in the store. Not for use by several readers at once: it keeps one signal and one way of reading ahead. */
export class Ranges implements Source {
  readonly sizeBytes: number;
  bytesRead = 0;
  /** Read at least this many bytes at once, or what comes within a second; for reading on and on. */
  ahead = 0;
  /** Ends what is being read. */
  signal: AbortSignal | undefined;

  private readonly blocks = new Map<number, Uint8Array>();
  private address: Address | undefined;
  private etag: string | undefined;
  private renewing: Promise<Address> | null = null;
  /** Of the last range that was read. */
  private bytesPerMs = Infinity;
  /** Where the last range ended, in blocks, and how many began where the one before them ended. */
  private end = -1;
  private inOrder = 0;
  private next: NextRange | null = null;

  constructor(private readonly options: RangesOptions) {
    this.sizeBytes = options.sizeBytes;
  }

  async read(offset: number, length: number): Promise<Uint8Array> {
    const end = offset + length;
    if (!(offset >= 0 && length >= 0 && end <= this.sizeBytes)) {
      throw new ReadFailure("index_damaged", `${length} bytes at ${offset} of ${this.sizeBytes}`);
    }
    if (length > MAX_READ_AT_ONCE) throw new ReadFailure("too_large", String(length));
    const whole = new Uint8Array(length);
    const last = Math.ceil(end / BLOCK);
    for (let block = Math.floor(offset / BLOCK); block < last; ) {
      const cached = this.cached(block);
      const bytes = cached ?? (await this.fetchBlocks(block, last));
      copyInto(whole, offset, bytes, block * BLOCK);
      block += Math.ceil(bytes.length / BLOCK);
    }
    return whole;
  }

  /** Fetch from `block` to the next one that is there already, or to `last`, or further if reading ahead. */
  private async fetchBlocks(block: number, last: number): Promise<Uint8Array> {
    const bytes = (this.next?.from === block ? await this.next.bytes : null) ?? (await this.fetchNow(block, last));
    this.bytesRead += bytes.length;
    for (let at = 0; at < bytes.length; at += BLOCK) this.cache(block + at / BLOCK, bytes.slice(at, at + BLOCK));
    this.inOrder = block === this.end ? this.inOrder + 1 : 1;
    this.end = block + Math.ceil(bytes.length / BLOCK);
    if (this.options.fetchesNext === true && this.inOrder >= LEAST_IN_ORDER) this.fetchNext(bytes.length);
    if (this.signal?.aborted === true) throw new ReadFailure("cancelled");
    return bytes;
  }

  private fetchNow(block: number, last: number): Promise<Uint8Array> {
    const ahead = Math.min(this.ahead, MAX_AHEAD_MS * this.bytesPerMs);
    return this.fetchUpTo(block, Math.max(last, block + Math.ceil(ahead / BLOCK)));
  }

  /** Begin to fetch what comes after the last range. */
  private fetchNext(length: number): void {
    const from = this.end;
    const count = Math.floor(Math.min(length, MAX_NEXT_MS * this.bytesPerMs) / BLOCK);
    const isNeeded = count > 0 && from * BLOCK < this.sizeBytes && !this.blocks.has(from);
    this.next = isNeeded ? { from, bytes: this.fetchUpTo(from, from + count).catch(() => null) } : null;
  }

  /** Fetch from a block to another, the end, or the first one that is there already. */
  private async fetchUpTo(block: number, last: number): Promise<Uint8Array> {
    const limit = Math.min(Math.ceil(this.sizeBytes / BLOCK), last);
    let until = block + 1;
    while (until < limit && !this.blocks.has(until)) until += 1;
    const start = block * BLOCK;
    const now = this.options.now ?? Date.now;
    const startMs = now();
    const bytes = await this.fetchRange(start, Math.min(until * BLOCK, this.sizeBytes));
    this.bytesPerMs = bytes.length / Math.max(1, now() - startMs);
    return bytes;
  }

  private cached(block: number): Uint8Array | undefined {
    const bytes = this.blocks.get(block);
    if (bytes !== undefined) {
      this.blocks.delete(block); // and put it back as the youngest
      this.blocks.set(block, bytes);
    }
    return bytes;
  }

  private cache(block: number, bytes: Uint8Array): void {
    this.blocks.set(block, bytes);
    for (const oldest of this.blocks.keys()) {
      if (this.blocks.size * BLOCK <= MAX_CACHED) break;
      this.blocks.delete(oldest);
    }
  }

  /** Fetches a range, again if the network fails; the time limit is for all attempts together. */
  private async fetchRange(start: number, end: number): Promise<Uint8Array> {
    const timeout = AbortSignal.timeout(STORE_TIMEOUT_MS);
    for (const pauseMs of REPEAT_AFTER_MS) {
      try {
        return await this.fetchOnce(start, end, timeout);
      } catch (thrown) {
        if (timeout.aborted || !(thrown instanceof ReadFailure) || thrown.code !== "store_unreachable") throw thrown;
      }
      await new Promise((resolve) => setTimeout(resolve, pauseMs));
      if (this.signal?.aborted === true) throw new ReadFailure("cancelled");
    }
    return this.fetchOnce(start, end, timeout);
  }

  private async fetchOnce(start: number, end: number, timeout: AbortSignal): Promise<Uint8Array> {
    const now = this.options.now ?? Date.now;
    const isFresh = this.address !== undefined && this.address.expiresAtMs - RENEW_BEFORE_MS > now();
    this.address = isFresh && this.address !== undefined ? this.address : await this.renewed();
    let response = await this.request(this.address.url, start, end, timeout);
    if (isFresh && EXPIRED.has(response.status)) {
      this.address = await this.renewed();
      response = await this.request(this.address.url, start, end, timeout);
    }
    if (!response.ok) throw new ReadFailure("store_refused", String(response.status));
    return this.body(response, start, end);
  }

  /** Two ranges that need another address get the same one. */
  private renewed(): Promise<Address> {
    this.renewing ??= this.options.renew().finally(() => (this.renewing = null));
    return this.renewing;
  }

  private async request(url: string, start: number, end: number, timeout: AbortSignal): Promise<Response> {
    const signal = this.signal === undefined ? timeout : AbortSignal.any([this.signal, timeout]);
    try {
      // The store's answers are for this reader alone: credentials of ours are never sent there.
      return await (this.options.fetch ?? fetch)(url, {
        headers: { Range: `bytes=${start}-${end - 1}` },
        credentials: "omit",
        referrerPolicy: "no-referrer",
        cache: "no-store",
        signal,
      });
    } catch {
      throw this.interrupted();
    }
  }

  private async body(response: Response, start: number, end: number): Promise<Uint8Array> {
    const whole = response.status === 200 && start === 0 && end === this.sizeBytes;
    if (response.status !== 206 && !whole) {
      await response.body?.cancel();
      throw new ReadFailure("store_refused", String(response.status));
    }
    this.checkSame(response, start, end);
    const bytes = await this.collect(response, end - start);
    if (bytes.length !== end - start) throw new ReadFailure("file_changed", `${bytes.length} of ${end - start}`);
    return bytes;
  }

  /** The store may hide these headers from scripts; where it shows them, they must agree. */
  private checkSame(response: Response, start: number, end: number): void {
    const range = response.headers.get("content-range");
    if (range !== null && range !== `bytes ${start}-${end - 1}/${this.sizeBytes}`) {
      throw new ReadFailure("file_changed", range);
    }
    const etag = response.headers.get("etag");
    if (etag !== null && this.etag !== undefined && etag !== this.etag) throw new ReadFailure("file_changed", etag);
    this.etag ??= etag ?? undefined;
  }

  private async collect(response: Response, length: number): Promise<Uint8Array> {
    const bytes = new Uint8Array(length);
    const reader = response.body?.getReader();
    let at = 0;
    try {
      for (let part = await reader?.read(); part?.value !== undefined; part = await reader?.read()) {
        if (at + part.value.length > length) throw new ReadFailure("file_changed", String(at + part.value.length));
        bytes.set(part.value, at);
        at += part.value.length;
        this.options.onBytes?.(part.value.length);
      }
    } catch (thrown) {
      void reader?.cancel().catch(() => undefined);
      throw thrown instanceof ReadFailure ? thrown : this.interrupted();
    }
    return bytes.subarray(0, at);
  }

  private interrupted(): ReadFailure {
    return new ReadFailure(this.signal?.aborted === true ? "cancelled" : "store_unreachable");
  }
}

function copyInto(target: Uint8Array, targetAt: number, source: Uint8Array, sourceAt: number): void {
  const from = Math.max(targetAt, sourceAt);
  const to = Math.min(targetAt + target.length, sourceAt + source.length);
  target.set(source.subarray(from - sourceAt, to - sourceAt), from - targetAt);
}
