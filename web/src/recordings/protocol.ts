/** What the page and the reading worker say to each other. */

import type { Curves } from "./curves/curves";
import type { FieldNode } from "./decoding/fields";
import type { FailureCode } from "./failures";
import type { Address } from "./ranges";

/** The formats that can be looked into here, as the server names them. */
export const READABLE_FORMATS = ["mcap", "rosbag1"] as const;
export type ReadableFormat = (typeof READABLE_FORMATS)[number];

export interface OpenRequest {
  kind: "open";
  format: ReadableFormat;
  sizeBytes: number;
}

/** Which picture: the first at or after `atNs` (the last before it where there is none), or its neighbours. */
export interface PictureRequest {
  kind: "picture";
  topic: string;
  atNs: bigint;
  step: "here" | "next" | "previous";
}

export interface FieldsRequest {
  kind: "fields";
  topic: string;
}

export interface CurvesRequest {
  kind: "curves";
  topic: string;
  fields: string[];
  fromNs: bigint;
  toNs: bigint;
  /** What it may read; less of the time is shown where the whole needs more. */
  mostBytes: number;
}

export type Request = OpenRequest | PictureRequest | FieldsRequest | CurvesRequest;

export interface Opened {
  /** Null where the recording holds no message. */
  span: { fromNs: bigint; toNs: bigint } | null;
  /** Null for a recording with an index; else how many bytes from its beginning were read to make one. */
  mendedUntil: number | null;
  topics: { name: string; messageType: string }[];
}

/** A part of the recording that could not be read, in seconds since its start. */
export interface DamagedPart {
  fromSeconds: number;
  toSeconds: number;
}

export interface ShownPicture {
  logTimeNs: bigint;
  bitmap: ImageBitmap;
  width: number;
  height: number;
  /** How it is written: "image/jpeg", "rgb8" … */
  encoding: string;
  range: [number, number] | null;
  /** Parts that were passed over on the way to it. */
  damaged: DamagedPart[];
}

export interface OfferedFields {
  fields: FieldNode[];
}

export interface DrawnCurves extends Curves {
  /** What the whole span costs to read, and until when was read (less than asked where that is too much). */
  wholeBytes: number;
  damaged: DamagedPart[];
  untilNs: bigint;
}

/** What the answer to a request is. */
export interface Answers {
  open: Opened;
  picture: ShownPicture;
  fields: OfferedFields;
  curves: DrawnCurves;
}

export type ToWorker =
  | { type: "ask"; id: number; request: Request }
  | { type: "cancel"; id: number }
  | { type: "address"; id: number; address: Address | null; reason: FailureCode };

export type FromWorker =
  | { type: "answer"; id: number; answer: Answers[keyof Answers] }
  | { type: "failure"; id: number; code: FailureCode; detail: string }
  | { type: "progress"; id: number; curves: DrawnCurves | null }
  | { type: "read"; bytes: number }
  | { type: "renew"; id: number };
