/** The picture in a message: compressed (JPEG, PNG, WebP), raw, or compressed depth. */

import { ReadFailure } from "../failures";
import { isFields, type Value } from "../decoding/decoder";
import { bytesOf } from "../geometry/values";
import { compressedDepthOf, type CompressedDepth } from "./compressed_depth";
import { checkSize, type RawPicture } from "./pixels";
import { isVideoType } from "../video/bitstream";

export interface Compressed {
  kind: "compressed";
  mime: string;
  data: Uint8Array;
}

export type Picture = Compressed | ({ kind: "raw" } & RawPicture) | ({ kind: "depth" } & CompressedDepth);

const NAME = /^(sensor_msgs[/.](msg[/.])?|foxglove(_msgs)?[/.](msg[/.])?)(CompressedImage|Image|RawImage)$/;
const MARKER = 0xff;
const WEBP_HEADER_BYTES = 30;
/** The bits of a side in WebP. */
const SIDE = 0x3fff;

/** Whether messages of a type are pictures that are shown here. */
export function isPictureType(messageType: string | null): boolean {
  return messageType !== null && (NAME.test(messageType) || isVideoType(messageType));
}

/** Return the picture of a message.
 *
 * @throws ReadFailure not_a_picture, picture_unreadable.
 */
export function pictureOf(message: Value): Picture {
  if (!isFields(message)) throw new ReadFailure("not_a_picture");
  const data = bytesOf(message.data);
  if (data === null) throw new ReadFailure("not_a_picture");
  const { width, height } = message;
  if (typeof width === "number" && typeof height === "number" && typeof message.encoding === "string") {
    const step = typeof message.step === "number" ? message.step : 0;
    const isBigEndian = message.is_bigendian === 1 || message.is_bigendian === true;
    return { kind: "raw", width, height, step, encoding: message.encoding, isBigEndian, data };
  }
  const format = typeof message.format === "string" ? message.format : "";
  const depth = compressedDepthOf(format, data);
  return depth === null ? compressed(data, format) : { kind: "depth", ...depth };
}

function compressed(data: Uint8Array, format: string): Compressed {
  const mime = mimeOf(data);
  if (data.length === 0) throw new ReadFailure("picture_unreadable", "0 bytes");
  if (mime === null) throw new ReadFailure("pixels_unknown", format.slice(0, 60));
  return { kind: "compressed", mime, data };
}

/** Return the format by the first bytes; null for others than JPEG, PNG and WebP. */
export function mimeOf(data: Uint8Array): string | null {
  const begins = (...bytes: number[]): boolean => bytes.every((byte, place) => data[place] === byte);
  if (begins(0xff, 0xd8, 0xff)) return "image/jpeg";
  if (begins(0x89, 0x50, 0x4e, 0x47)) return "image/png";
  if (begins(0x52, 0x49, 0x46, 0x46) && data[8] === 0x57 && data[9] === 0x45) return "image/webp";
  return null;
}

/** Refuse a compressed picture with huge dimensions before memory is allocated for it.
 *
 * @throws ReadFailure picture_too_large, picture_unreadable where the dimensions are missing.
 */
export function checkCompressed({ mime, data }: Compressed): void {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  if (mime === "image/webp") {
    checkWebp(view);
    return;
  }
  if (mime === "image/png") {
    if (data.length < 24) throw new ReadFailure("picture_unreadable", "it is cut off");
    checkSize(view.getUint32(16), view.getUint32(20));
    return;
  }
  for (let at = 2; at + 9 < data.length; ) {
    if (data[at] !== MARKER) break;
    const marker = data[at + 1] ?? 0;
    if (marker === MARKER) at += 1; // padding
    else if (isFrame(marker)) {
      checkSize(view.getUint16(at + 7), view.getUint16(at + 5));
      return;
    } else at += 2 + view.getUint16(at + 2);
  }
  throw new ReadFailure("picture_unreadable", "it does not say its size");
}

/** Source: RFC 9649 (WebP), 2.7.1 (extended), 3 (lossless); RFC 6386 (VP8), 9.1. */
function checkWebp(view: DataView): void {
  if (view.byteLength < WEBP_HEADER_BYTES) throw new ReadFailure("picture_unreadable", "it is cut off");
  const kind = view.getUint8(15);
  if (kind === 0x58) checkSize(1 + (view.getUint32(24, true) & 0xffffff), 1 + (view.getUint32(26, true) >>> 8)); // VP8X
  else if (kind === 0x4c) checkSize(1 + (view.getUint16(21, true) & SIDE), 1 + ((view.getUint32(21, true) >>> 14) & SIDE)); // VP8L
  else checkSize(view.getUint16(26, true) & SIDE, view.getUint16(28, true) & SIDE);
}

/** Start-of-frame markers, which are C0 to CF but for tables (C4, CC) and what is reserved (C8). */
function isFrame(marker: number): boolean {
  return marker >= 0xc0 && marker <= 0xcf && marker !== 0xc4 && marker !== 0xc8 && marker !== 0xcc;
}
