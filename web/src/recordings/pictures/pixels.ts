/** Raw pixels of sensor_msgs/Image and foxglove.RawImage, made into RGBA; those of depth, made into numbers.
 *
 * Source: sensor_msgs/image_encodings.hpp for the encodings; ITU-R BT.601 (full range) for YUV, as ROS converts it.
 */

import { ReadFailure } from "../failures";
import { MAX_PIXELS } from "../limits";
import { pictureValues, type PictureValues } from "./values";

export interface RawPicture {
  width: number;
  height: number;
  /** Bytes of a row. */
  step: number;
  encoding: string;
  isBigEndian: boolean;
  data: Uint8Array;
}

export interface ColourPixels {
  width: number;
  height: number;
  rgba: Uint8ClampedArray<ArrayBuffer>;
}

export type Pixels = ColourPixels | PictureValues;

type Paint = (picture: RawPicture, rgba: Uint8ClampedArray) => void;
type Get = (view: DataView, at: number, isLittleEndian: boolean) => number;

interface ColourEncoding {
  bytesPerPixel: number;
  paint: Paint;
}

/** One number a pixel, of which the reader chooses the colours. */
interface ValueEncoding {
  bytesPerPixel: number;
  unit: PictureValues["unit"];
  get: Get;
}

const ENCODINGS: Readonly<Record<string, ColourEncoding | ValueEncoding>> = {
  rgb8: channels(3, [0, 1, 2]),
  "8uc3": channels(3, [2, 1, 0]),
  bgr8: channels(3, [2, 1, 0]),
  rgba8: channels(4, [0, 1, 2, 3]),
  bgra8: channels(4, [2, 1, 0, 3]),
  "8uc4": channels(4, [2, 1, 0, 3]),
  mono8: channels(1, [0, 0, 0]),
  "8uc1": channels(1, [0, 0, 0]),
  mono16: { bytesPerPixel: 2, unit: null, get: (view, at, isLittleEndian) => view.getUint16(at, isLittleEndian) },
  "16uc1": { bytesPerPixel: 2, unit: "mm", get: (view, at, isLittleEndian) => view.getUint16(at, isLittleEndian) },
  "16sc1": { bytesPerPixel: 2, unit: null, get: (view, at, isLittleEndian) => view.getInt16(at, isLittleEndian) },
  "32fc1": { bytesPerPixel: 4, unit: "m", get: (view, at, isLittleEndian) => view.getFloat32(at, isLittleEndian) },
  bayer_rggb8: bayer([0, 1, 1, 2]),
  bayer_bggr8: bayer([2, 1, 1, 0]),
  bayer_gbrg8: bayer([1, 2, 0, 1]),
  bayer_grbg8: bayer([1, 0, 2, 1]),
  yuv422: yuv([1, 3], 0, 2),
  uyvy: yuv([1, 3], 0, 2),
  yuv422_yuy2: yuv([0, 2], 1, 3),
  yuyv: yuv([0, 2], 1, 3),
};

/** Return the picture as RGBA, or as numbers where it has one of more than 8 bits for each pixel.
 *
 * @throws ReadFailure pixels_unknown, picture_too_large, picture_unreadable where bytes are missing.
 */
export function pixelsOf(picture: RawPicture): Pixels {
  const name = picture.encoding.toLowerCase();
  const encoding = Object.hasOwn(ENCODINGS, name) ? ENCODINGS[name] : undefined;
  if (encoding === undefined) throw new ReadFailure("pixels_unknown", picture.encoding.slice(0, 60));
  const { width, height, data } = picture;
  checkSize(width, height);
  const row = width * encoding.bytesPerPixel;
  const step = picture.step === 0 ? row : picture.step;
  if (!(step >= row)) throw new ReadFailure("picture_unreadable", `rows of ${step} bytes for ${width} × ${height}`);
  if ((height - 1) * step + row > data.length) throw new ReadFailure("picture_unreadable", `${data.length} bytes for ${width} × ${height}`);
  if ("get" in encoding) return pictureValues(width, height, valuesOf({ ...picture, step }, encoding), encoding.unit);
  const rgba = new Uint8ClampedArray(width * height * 4);
  encoding.paint({ ...picture, step }, rgba);
  return { width, height, rgba };
}

/** @throws ReadFailure picture_too_large, or picture_unreadable where it has no size. */
export function checkSize(width: number, height: number, maxPixels = MAX_PIXELS): void {
  if (!(Number.isInteger(width) && Number.isInteger(height) && width > 0 && height > 0)) throw new ReadFailure("picture_unreadable", `${width} × ${height}`);
  if (width * height > maxPixels) throw new ReadFailure("picture_too_large", `${width} × ${height}`);
}

function channels(bytesPerPixel: number, [red, green, blue, alpha]: readonly [number, number, number, number?]): ColourEncoding {
  const paint: Paint = ({ width, height, step, data }, rgba) => {
    for (let y = 0, to = 0; y < height; y++) {
      for (let x = 0, from = y * step; x < width; x++, from += bytesPerPixel, to += 4) {
        rgba[to] = data[from + red] ?? 0;
        rgba[to + 1] = data[from + green] ?? 0;
        rgba[to + 2] = data[from + blue] ?? 0;
        rgba[to + 3] = alpha === undefined ? 255 : (data[from + alpha] ?? 0);
      }
    }
  };
  return { bytesPerPixel, paint };
}

function valuesOf({ width, height, step, data, isBigEndian }: RawPicture, { bytesPerPixel, get }: ValueEncoding): Float32Array<ArrayBuffer> {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const values = new Float32Array(width * height);
  for (let y = 0, to = 0; y < height; y++) {
    for (let x = 0, from = y * step; x < width; x++, from += bytesPerPixel, to++) values[to] = get(view, from, !isBigEndian);
  }
  return values;
}

/** Each square of four takes its one red, one blue, and the mean of its greens; `pattern`: colour by place, row by row. */
function bayer(pattern: readonly [number, number, number, number]): ColourEncoding {
  const paint: Paint = ({ width, height, step, data }, rgba) => {
    for (let y = 0; y < height; y++) {
      const top = Math.max(0, Math.min(y - (y % 2), height - 2));
      for (let x = 0; x < width; x++) {
        const left = Math.max(0, Math.min(x - (x % 2), width - 2));
        const sums = [0, 0, 0];
        pattern.forEach((colour, place) => {
          const at = Math.min(top + (place >> 1), height - 1) * step + Math.min(left + (place & 1), width - 1);
          sums[colour] = (sums[colour] ?? 0) + (data[at] ?? 0);
        });
        const to = (y * width + x) * 4;
        rgba[to] = sums[0] ?? 0;
        rgba[to + 1] = (sums[1] ?? 0) / 2;
        rgba[to + 2] = sums[2] ?? 0;
        rgba[to + 3] = 255;
      }
    }
  };
  return { bytesPerPixel: 1, paint };
}

/** Two pixels share four bytes: where their lights, and where the colour's u and v are. */
function yuv(lights: readonly [number, number], uAt: number, vAt: number): ColourEncoding {
  const paint: Paint = ({ width, height, step, data }, rgba) => {
    for (let y = 0, to = 0; y < height; y++) {
      for (let x = 0; x < width; x++, to += 4) {
        const pair = y * step + (x >> 1) * 4;
        const light = data[pair + lights[x & 1 ? 1 : 0]] ?? 0;
        const u = (data[pair + uAt] ?? 128) - 128;
        const v = (data[pair + vAt] ?? 128) - 128;
        rgba[to] = light + 1.402 * v;
        rgba[to + 1] = light - 0.344136 * u - 0.714136 * v;
        rgba[to + 2] = light + 1.772 * u;
        rgba[to + 3] = 255;
      }
    }
  };
  return { bytesPerPixel: 2, paint };
}
