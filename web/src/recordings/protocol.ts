/** Messages between the page and the reading worker. */

import type { Curves } from "./curves/curves";
import type { FieldNode } from "./decoding/fields";
import type { FailureCode } from "./failures";
import type { MessageRequest, MessagesRequest, ReadMessage } from "./products/products";
import type { Address } from "./ranges";
import type { SliceRequest, SliceResult } from "./slices/slice";

/** Formats that the preview reads, by their names in the API. */
export const READABLE_FORMATS = ["mcap", "rosbag1", "db3", "ulog"] as const;
export type ReadableFormat = (typeof READABLE_FORMATS)[number];

/** The recording to open. */
export interface RecordingFile {
  format: ReadableFormat;
  sizeBytes: number;
  /** Decompressed chunks that stay in memory; `MAX_CHUNK_CACHE` if absent. */
  cacheBytes?: number;
}

/** Which time of a message: when it was recorded, or the stamp of its header where that can be used. */
export type CurveTime = "log" | "header";

export interface CurvesRequest {
  topic: string;
  /** Paths of fields, or what is computed from them (`curves/derivations.ts`). */
  fields: string[];
  /** Log time if absent. */
  time?: CurveTime;
  fromNs: bigint;
  toNs: bigint;
  /** Byte limit; a recording that needs more is shown up to the time that the limit permits. */
  maxBytes: number;
}

export interface Opened {
  /** Null where the recording holds no message. */
  span: { fromNs: bigint; toNs: bigint } | null;
  /** Null for a recording with an index; else how many bytes from its beginning were read to make one. */
  indexedUntil: number | null;
  topics: { name: string; messageType: string }[];
}

/** A part of the recording that could not be read, in seconds since its start. */
export interface DamagedPart {
  fromSeconds: number;
  toSeconds: number;
}

export interface FoundMessage {
  /** Null where there is none. */
  message: ReadMessage | null;
  /** How far it was searched, where the byte limit ended the search; else null. */
  searchedToNs: bigint | null;
  /** Parts that were passed over on the way to it. */
  damaged: DamagedPart[];
}

export interface ReadMessages {
  messages: ReadMessage[];
  /** The end of what was read: the end of the request, or less where a limit was reached. */
  untilNs: bigint;
  damaged: DamagedPart[];
}

export interface OfferedFields {
  fields: FieldNode[];
}

export interface DrawnCurves extends Curves {
  /** The bytes of the whole span. `untilNs` is the end of what was read. */
  wholeBytes: number;
  /** The bytes of the topic in the whole recording. */
  topicBytes: number;
  damaged: DamagedPart[];
  untilNs: bigint;
  /** Messages with a log time although the time of headers was requested. */
  unstamped: number;
}

/** A slice, and where it is written: into a file, or into memory. */
export interface SliceOrder extends SliceRequest {
  handle: FileSystemFileHandle | null;
}

export interface MadeSlice extends SliceResult {
  /** The slice, where it was written into memory. */
  blob: Blob | null;
}

/** The share of a slice that is done, from 0 to 1, and its bytes so far. */
export interface SliceProgress {
  share: number;
  bytes: number;
}

/** Requests of the page by kind, each with its answer. A viewer that needs other data adds its kind here. */
export interface Requests {
  open: { request: RecordingFile; answer: Opened };
  message: { request: MessageRequest; answer: FoundMessage };
  messages: { request: MessagesRequest; answer: ReadMessages };
  fields: { request: { topic: string }; answer: OfferedFields };
  curves: { request: CurvesRequest; answer: DrawnCurves };
  slice: { request: SliceOrder; answer: MadeSlice };
}

export type RequestKind = keyof Requests;
export type Answer<K extends RequestKind = RequestKind> = Requests[K]["answer"];
export type Request = { [K in RequestKind]: { kind: K } & Requests[K]["request"] }[RequestKind];

export type ToWorker =
  | { type: "request"; id: number; priority: number; request: Request }
  | { type: "cancel"; id: number }
  | { type: "address"; id: number; address: Address | null; reason: FailureCode };

export type FromWorker =
  | { type: "answer"; id: number; answer: Answer }
  | { type: "failure"; id: number; code: FailureCode; detail: string }
  | { type: "progress"; id: number; curves: DrawnCurves }
  | { type: "sliced"; id: number; progress: SliceProgress }
  | { type: "read"; bytes: number }
  | { type: "renew"; id: number };
