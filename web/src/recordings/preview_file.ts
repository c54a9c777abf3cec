/** Reads the preview of a recording by ranges: its index, then only the sections that are needed.
 *
 * The bytes come from a process that parsed an untrusted recording: every number in them is only a claim.
 * Format: docs/formats.md, "Previews of recordings".
 */

import { ReadFailure } from "./failures";
import { MAX_POINTS } from "./limits";
import type { ByteSource } from "./ranges";

const MAGIC = "KLPREV1\n";
const HEAD_BYTES = 16;
const VERSION = 1;
const MAX_INDEX_BYTES = 16 * 2 ** 20;
const MAX_SECTION_BYTES = 32 * 2 ** 20;

type Entry = Readonly<Record<string, unknown>>;

/** The numeric fields of a topic, in bins of equally many consecutive messages. */
export interface PreviewSeries {
  readonly messagesPerBin: number;
  /** Log times of the first and last message of each bin, in nanoseconds. */
  readonly firstNs: BigInt64Array;
  readonly lastNs: BigInt64Array;
  /** By requested field: the least and greatest value in each bin, NaN where there is none; null for an unknown field. */
  readonly fields: readonly (PreviewField | null)[];
  /** The first and last time of each part of the recording that was read, in order; empty where it is one. */
  readonly readSpans: BigInt64Array;
}

export interface PreviewField {
  readonly low: ArrayLike<number>;
  readonly high: ArrayLike<number>;
}

/** Thinned positions of GNSS. */
export interface PreviewTrack {
  /** Log times in nanoseconds. */
  readonly timesNs: BigInt64Array;
  /** Of each: latitude and longitude in degrees, altitude in metres; NaN for an altitude that is not known. */
  readonly positions: Float64Array;
}

/** A line of a log; `severity` is one of Kleinkram's words, or another text. */
export interface PreviewLine {
  readonly timeNs: bigint;
  readonly severity: string;
  readonly source: string;
  readonly text: string;
}

/** Small pictures of a camera, evenly spread over its messages. */
export interface PreviewCamera {
  readonly topic: string;
  readonly thumbnails: readonly { readonly timeNs: bigint; readonly width: number; readonly height: number; readonly jpeg: Blob }[];
}

/** Some points of a cloud. */
export interface PreviewCloud {
  readonly timeNs: bigint;
  readonly frame: string;
  /** Points of the whole cloud. */
  readonly totalPoints: number;
  /** x, y, z of each point in metres, which may not be finite. */
  readonly xyz: Float32Array;
}

export class PreviewFile {
  private constructor(
    private readonly source: ByteSource,
    private readonly index: Entry,
    private readonly sectionsAt: number,
  ) {}

  /** Read the index. @throws ReadFailure index_damaged, for what is no preview of this version. */
  static async open(source: ByteSource): Promise<PreviewFile> {
    if (source.sizeBytes < HEAD_BYTES) throw damaged("too short");
    const head = await source.read(0, HEAD_BYTES);
    const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
    const [stored, unpacked] = [view.getUint32(8, true), view.getUint32(12, true)];
    if (new TextDecoder().decode(head.subarray(0, MAGIC.length)) !== MAGIC) throw damaged("no preview");
    if (stored > MAX_INDEX_BYTES || unpacked > MAX_INDEX_BYTES) throw damaged("its index is too large");
    const index = asEntry(parsed(await inflated(await source.read(HEAD_BYTES, stored), unpacked)));
    if (index.version !== VERSION) throw damaged("another version");
    return new PreviewFile(source, index, HEAD_BYTES + stored);
  }

  /** Return the bins of a topic; null where the preview has none of it. */
  async series(topic: string, fields: readonly string[]): Promise<PreviewSeries | null> {
    const entry = entries(this.index.series).find((series) => series.topic === topic);
    if (entry === undefined) return null;
    const firstNs = await this.times(entry.first_ns);
    const lastNs = entry.last_ns === undefined ? firstNs : await this.times(entry.last_ns);
    if (lastNs.length !== firstNs.length) throw damaged("different lengths");
    const offered = entries(entry.fields);
    const values = fields.map((name) => this.field(offered.find((field) => field.name === name), firstNs.length));
    const readSpans = this.index.read_spans === undefined ? new BigInt64Array() : await this.times(this.index.read_spans);
    return { messagesPerBin: natural(entry.messages_per_bin), firstNs, lastNs, fields: await Promise.all(values), readSpans };
  }

  /** Return the track of a topic with GNSS fixes; null where the preview has none of it. */
  async track(topic: string): Promise<PreviewTrack | null> {
    const entry = entries(this.index.tracks).find((track) => track.topic === topic && track.kind === "gnss");
    if (entry === undefined) return null;
    const timesNs = await this.times(entry.times_ns);
    const positions = Float64Array.from(await this.numbers(entry.positions));
    if (positions.length !== 3 * timesNs.length) throw damaged("different lengths");
    return { timesNs, positions };
  }

  /** Return the first and the most severe lines of a topic, by time. */
  async lines(topic: string): Promise<readonly PreviewLine[]> {
    const section = asEntry(asEntry(this.index.logs).lines);
    const size = natural(section.unpacked);
    if (size > MAX_SECTION_BYTES) throw damaged("a section of this size");
    const lines = parsed(await inflated(await this.section(section), size), "a section");
    if (!Array.isArray(lines)) throw damaged("a section");
    return lines.map(lineOf).flatMap(({ of, ...line }) => (of === topic ? [line] : []));
  }

  /** Return the paths of the numeric fields of a topic; none where the preview has none of it. */
  fieldsOf(topic: string): readonly string[] {
    const entry = entries(this.index.series).find((series) => series.topic === topic);
    return entry === undefined ? [] : entries(entry.fields).map(({ name }) => String(name));
  }

  /** Return the topics of the cameras that have thumbnails. */
  get cameras(): readonly string[] {
    return entries(this.index.cameras).filter(({ thumbnails }) => entries(thumbnails).length > 0).map(({ topic }) => String(topic));
  }

  /** Return the thumbnails of a camera; null where the preview has none of it. */
  async camera(topic: string): Promise<PreviewCamera | null> {
    const entry = entries(this.index.cameras).find((camera) => camera.topic === topic);
    if (entry === undefined) return null;
    const files = await this.section(entry.files);
    let at = 0;
    const thumbnails = entries(entry.thumbnails).map(({ time_ns, width, height, size }) => {
      const bytes = files.slice(at, at + natural(size));
      at += natural(size);
      if (at > files.length) throw damaged("a picture is outside of its section");
      return { timeNs: timeOf(time_ns), width: natural(width), height: natural(height), jpeg: new Blob([bytes], { type: "image/jpeg" }) };
    });
    return { topic, thumbnails };
  }

  /** Return the log times of the clouds of a topic, in order. */
  cloudTimes(topic: string): readonly bigint[] {
    return this.cloudsOf(topic).map(({ time_ns }) => timeOf(time_ns)).toSorted((a, b) => (a < b ? -1 : 1));
  }

  /** Return a cloud by its topic and log time; null where the preview has none of it. */
  async cloud(topic: string, timeNs: bigint): Promise<PreviewCloud | null> {
    const entry = this.cloudsOf(topic).find(({ time_ns }) => timeOf(time_ns) === timeNs);
    if (entry === undefined) return null;
    const xyz = Float32Array.from(await this.numbers(entry.xyz));
    if (xyz.length % 3 !== 0 || xyz.length > 3 * MAX_POINTS) throw damaged("a cloud of this size");
    return { timeNs, frame: String(entry.frame_id), totalPoints: natural(entry.count), xyz };
  }

  private cloudsOf(topic: string): Entry[] {
    return entries(this.index.clouds).filter((cloud) => cloud.topic === topic);
  }

  private async field(entry: Entry | undefined, bins: number): Promise<PreviewField | null> {
    if (entry === undefined) return null;
    if (typeof entry.constant === "number") {
      const values = new Float64Array(bins).fill(entry.constant);
      return { low: values, high: values };
    }
    const low = await this.numbers(entry.low);
    const high = entry.high === undefined ? low : await this.numbers(entry.high);
    if (low.length !== bins || high.length !== bins) throw damaged("different lengths");
    return { low, high };
  }

  private async numbers(value: unknown): Promise<Float32Array | Float64Array> {
    const { dtype } = asEntry(value);
    if (dtype !== "float32" && dtype !== "float64") throw damaged("unknown numbers");
    const Numbers = dtype === "float32" ? Float32Array : Float64Array;
    return new Numbers(await this.unpackedSection(value, Numbers.BYTES_PER_ELEMENT));
  }

  private async times(value: unknown): Promise<BigInt64Array> {
    if (asEntry(value).dtype !== "int64") throw damaged("unknown numbers");
    return new BigInt64Array(await this.unpackedSection(value, BigInt64Array.BYTES_PER_ELEMENT));
  }

  private async unpackedSection(value: unknown, elementBytes: number): Promise<ArrayBuffer> {
    const size = natural(asEntry(value).unpacked);
    if (size > MAX_SECTION_BYTES || size % elementBytes !== 0) throw damaged("a section of this size");
    return (await inflated(await this.section(value), size)).buffer;
  }

  private section(value: unknown): Promise<Uint8Array<ArrayBuffer>> {
    const { offset, length } = asEntry(value);
    if (natural(length) > MAX_SECTION_BYTES) throw damaged("a section of this size");
    return this.source.read(this.sectionsAt + natural(offset), natural(length)) as Promise<Uint8Array<ArrayBuffer>>;
  }
}

function damaged(reason: string): ReadFailure {
  return new ReadFailure("index_damaged", `preview: ${reason}`);
}

/** Return what was compressed; it must have exactly the announced size. */
async function inflated(packed: Uint8Array, size: number): Promise<Uint8Array<ArrayBuffer>> {
  const target = new Uint8Array(size);
  const reader = new Blob([packed as Uint8Array<ArrayBuffer>]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  let at = 0;
  try {
    for (let part = await reader.read(); part.value !== undefined; part = await reader.read()) {
      if (at + part.value.length > size) throw damaged("a section is too large");
      target.set(part.value, at);
      at += part.value.length;
    }
  } catch (thrown) {
    void reader.cancel().catch(() => undefined);
    throw thrown instanceof ReadFailure ? thrown : damaged("a section cannot be decompressed");
  }
  if (at !== size) throw damaged("a section is too short");
  return target;
}

function parsed(bytes: Uint8Array, what = "its index"): unknown {
  try {
    return JSON.parse(new TextDecoder().decode(bytes));
  } catch {
    throw damaged(`${what} is no JSON`);
  }
}

function lineOf(line: unknown): PreviewLine & { readonly of: string } {
  const [timeNs, of, severity, source, text] = Array.isArray(line) ? (line as unknown[]) : [];
  if (typeof of !== "string" || typeof severity !== "string" || typeof source !== "string" || typeof text !== "string") throw damaged("a line");
  return { timeNs: timeOf(timeNs), of, severity, source, text };
}

function asEntry(value: unknown): Entry {
  if (typeof value !== "object" || value === null || Array.isArray(value)) throw damaged("its index");
  return value as Entry;
}

function entries(value: unknown): Entry[] {
  if (!Array.isArray(value)) throw damaged("its index");
  return value.map(asEntry);
}

function natural(value: unknown): number {
  if (!Number.isSafeInteger(value) || (value as number) < 0) throw damaged("its index");
  return value as number;
}

function timeOf(value: unknown): bigint {
  if (typeof value !== "string" || !/^-?\d{1,19}$/.test(value)) throw damaged("its index");
  return BigInt(value);
}
