// The dimensions of a picture by its header, before a browser allocates memory for it.
import { hasBytes } from "./content";
import { ReadFailure } from "@/recordings/failures";
import { checkSize } from "@/recordings/pictures/pixels";
import type { ByteSource } from "@/recordings/ranges";

/** Where dimensions are in the header of a format, at most. */
const HEADER_BYTES = 32;
const MAX_SEGMENTS = 500;

type Size = readonly [width: number, height: number];
export type PictureType = "image/png" | "image/jpeg" | "image/gif" | "image/webp" | "image/bmp";

/** Returns the type of a picture that browsers show, by its first bytes; null for other files. */
export function pictureType(head: Uint8Array): PictureType | null {
  if (hasBytes(head, [0x89, 0x50, 0x4e, 0x47])) return "image/png";
  if (hasBytes(head, [0xff, 0xd8, 0xff])) return "image/jpeg";
  if (hasBytes(head, "GIF8")) return "image/gif";
  if (hasBytes(head, "RIFF") && hasBytes(head, "WEBP", 8)) return "image/webp";
  return hasBytes(head, "BM") && hasBytes(head, [0, 0, 0, 0], 6) ? "image/bmp" : null;
}

/** Return the dimensions of a picture.
 *
 * @throws ReadFailure picture_unreadable, picture_too_large.
 */
export async function pictureSize(source: ByteSource, type: PictureType): Promise<Size> {
  const head = await source.read(0, Math.min(HEADER_BYTES, source.sizeBytes));
  if (head.length < HEADER_BYTES) throw new ReadFailure("picture_unreadable", "it is cut off");
  const size = type === "image/jpeg" ? await jpegSize(source) : SIZES[type](new DataView(head.buffer, head.byteOffset, head.byteLength), head);
  checkSize(...size);
  return size;
}

const SIZES: Readonly<Record<Exclude<PictureType, "image/jpeg">, (view: DataView, head: Uint8Array) => Size>> = {
  "image/png": (view) => [view.getUint32(16), view.getUint32(20)],
  "image/gif": (view) => [view.getUint16(6, true), view.getUint16(8, true)],
  "image/bmp": (view) => (view.getUint32(14, true) === 12 ? [view.getUint16(18, true), view.getUint16(20, true)] : [view.getInt32(18, true), Math.abs(view.getInt32(22, true))]),
  "image/webp": webpSize,
};

/** Source: RFC 9649 (WebP), RFC 6386 (VP8). */
function webpSize(view: DataView, head: Uint8Array): Size {
  const uint24 = (at: number): number => view.getUint16(at, true) + (view.getUint8(at + 2) << 16);
  if (hasBytes(head, "VP8X", 12)) return [uint24(24) + 1, uint24(27) + 1];
  if (hasBytes(head, "VP8L", 12)) {
    const bits = view.getUint32(21, true);
    return [(bits & 0x3fff) + 1, ((bits >>> 14) & 0x3fff) + 1];
  }
  if (hasBytes(head, "VP8 ", 12)) return [view.getUint16(26, true) & 0x3fff, view.getUint16(28, true) & 0x3fff];
  throw new ReadFailure("picture_unreadable", "it does not say its size");
}

/** Follows the segments of a JPEG to its frame header; metadata before it may be long. */
async function jpegSize(source: ByteSource): Promise<Size> {
  let at = 2;
  for (let count = 0; count < MAX_SEGMENTS && at + 9 < source.sizeBytes; count += 1) {
    const bytes = await source.read(at, 9);
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const marker = bytes[1] ?? 0;
    if (bytes[0] !== 0xff) break;
    if (marker === 0xff) at += 1; // padding
    else if (marker >= 0xc0 && marker <= 0xcf && ![0xc4, 0xc8, 0xcc].includes(marker)) return [view.getUint16(7), view.getUint16(5)];
    else at += 2 + view.getUint16(2);
  }
  throw new ReadFailure("picture_unreadable", "it does not say its size");
}
