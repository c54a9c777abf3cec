/** Depth as the ROS transport `compressedDepth` writes it: 12 bytes of settings, then a PNG or RVL.
 *
 * Sources: compressed_depth_image_transport (codec.cpp, rvl_codec.cpp); A. D. Wilson, "Fast Lossless Depth Image
 * Compression", 2017 (RVL).
 */

import { ReadFailure } from "../failures";
import { MAX_GREY_PIXELS } from "../limits";
import { checkSize } from "./pixels";
import { pictureValues, type PictureValues } from "./values";

export interface CompressedDepth {
  /** "16UC1" or "32FC1" in general. */
  encoding: string;
  codec: "png" | "rvl";
  /** Depth of 32 bits is stored as `a / depth + b`. */
  quantisation: readonly [a: number, b: number];
  data: Uint8Array;
}

const SETTINGS_BYTES = 12;
const [A_AT, B_AT] = [4, 8];
const SIZE_BYTES = 8;
/** Characters of a format that are looked at. */
const MAX_FORMAT = 200;
/** Of a number of 32 bits; more occur in damaged data only. */
const MAX_GROUPS = 11;

/** Return what the transport wrote; null for pictures of other transports. @throws ReadFailure picture_unreadable. */
export function compressedDepthOf(format: string, data: Uint8Array): CompressedDepth | null {
  const match = /^([^;]*);\s*compressedDepth\s*(\w*)/.exec(format.slice(0, MAX_FORMAT));
  if (match === null) return null;
  const [, encoding = "", codec = ""] = match;
  if (data.length < SETTINGS_BYTES) throw new ReadFailure("picture_unreadable", `${data.length} bytes`);
  if (codec !== "" && codec !== "png" && codec !== "rvl") throw new ReadFailure("pixels_unknown", format.slice(0, 60));
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const quantisation = [view.getFloat32(A_AT, true), view.getFloat32(B_AT, true)] as const;
  return { encoding: encoding.trim().slice(0, 60), codec: codec === "rvl" ? "rvl" : "png", quantisation, data: data.subarray(SETTINGS_BYTES) };
}

/** Return depth from its stored numbers. */
export function depthValues({ encoding, quantisation: [a, b] }: CompressedDepth, width: number, height: number, stored: Uint16Array): PictureValues {
  const name = encoding.toLowerCase();
  if (name !== "32fc1") return pictureValues(width, height, new Float32Array(stored), name === "16uc1" ? "mm" : null);
  const values = new Float32Array(stored.length);
  for (const [at, inverse] of stored.entries()) values[at] = inverse === 0 ? Number.NaN : a / (inverse - b);
  return pictureValues(width, height, values, "m");
}

/** Return the numbers of an RVL stream behind its size. @throws ReadFailure picture_unreadable, picture_too_large. */
export function rvlPixels(data: Uint8Array): { width: number; height: number; pixels: Uint16Array } {
  if (data.length < SIZE_BYTES) throw new ReadFailure("picture_unreadable", `${data.length} bytes`);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const [width, height] = [view.getUint32(0, true), view.getUint32(4, true)];
  checkSize(width, height, MAX_GREY_PIXELS);
  const groups = new Groups(view);
  const pixels = new Uint16Array(width * height);
  let last = 0;
  for (let at = 0; at < pixels.length; ) {
    at += groups.number(); // zeros
    const measured = groups.number();
    if (at + measured > pixels.length) throw new ReadFailure("picture_unreadable", "it has more pixels than its size");
    for (const end = at + measured; at < end; at++) {
      const code = groups.number();
      last += (code >>> 1) ^ -(code & 1);
      pixels[at] = last;
    }
  }
  return { width, height, pixels };
}

/** Numbers of variable length: groups of three bits behind one that says whether another follows, eight in a word. */
class Groups {
  private at = SIZE_BYTES;
  private word = 0;
  private left = 0;

  constructor(private readonly view: DataView) {}

  number(): number {
    let number = 0;
    for (let place = 0; place < MAX_GROUPS; place++) {
      const group = this.group();
      number |= (group & 7) << (3 * place);
      if (group < 8) return number >>> 0;
    }
    throw new ReadFailure("picture_unreadable", "a number is too long");
  }

  private group(): number {
    if (this.left === 0) {
      if (this.at + 4 > this.view.byteLength) throw new ReadFailure("picture_unreadable", "it is cut off");
      this.word = this.view.getUint32(this.at, true);
      this.at += 4;
      this.left = 8;
    }
    this.left -= 1;
    return (this.word >>> (4 * this.left)) & 15;
  }
}
