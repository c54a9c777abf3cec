/** The picture in a message: compressed (JPEG, PNG, WebP) or raw. */

import { ReadFailure } from "../failures";
import { isFields, isNumbers, type Value } from "../decoding/decoder";
import { checkSize, type RawPicture } from "./pixels";

export interface Compressed {
  kind: "compressed";
  mime: string;
  data: Uint8Array;
}

export type Picture = Compressed | ({ kind: "raw" } & RawPicture);

const NAME = /^(sensor_msgs[/.](msg[/.])?|foxglove(_msgs)?[/.](msg[/.])?)(CompressedImage|Image|RawImage)$/;
/** Depth as image_transport compresses it: a PNG behind 12 bytes of settings. */
const DEPTH_PREFIX = 12;
const MARKER = 0xff;

/** Whether messages of a type are pictures that are shown here. */
export function isPictureType(messageType: string | null): boolean {
  return messageType !== null && NAME.test(messageType);
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
  return compressed(data, typeof message.format === "string" ? message.format : "");
}

function compressed(data: Uint8Array, format: string): Compressed {
  for (const start of [0, DEPTH_PREFIX]) {
    const bytes = data.subarray(start);
    const mime = mimeOf(bytes);
    if (mime !== null) return { kind: "compressed", mime, data: bytes };
  }
  throw new ReadFailure("pixels_unknown", format.slice(0, 60));
}

function mimeOf(data: Uint8Array): string | null {
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
  if (mime === "image/webp") return; // at most 16383 pixels a side, by its format
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

/** Start-of-frame markers, which are C0 to CF but for tables (C4, CC) and what is reserved (C8). */
function isFrame(marker: number): boolean {
  return marker >= 0xc0 && marker <= 0xcf && marker !== 0xc4 && marker !== 0xc8 && marker !== 0xcc;
}

/** Bytes as such, as numbers, or in base64 (JSON). */
function bytesOf(value: Value | undefined): Uint8Array | null {
  if (value instanceof Uint8Array) return value;
  if (isNumbers(value)) return new Uint8Array(value.buffer, value.byteOffset, value.byteLength);
  if (Array.isArray(value)) return Uint8Array.from(value, (item) => (typeof item === "number" ? item : 0));
  if (typeof value !== "string") return null;
  try {
    return Uint8Array.from(atob(value), (letter) => letter.charCodeAt(0));
  } catch {
    return null;
  }
}
