// Which pixel of a picture is under the pointer, and its value.
import { isMeasured, type PictureValues } from "@/recordings/pictures/values";

interface Size {
  readonly width: number;
  readonly height: number;
}

export interface Pixel {
  readonly x: number;
  readonly y: number;
}

const DIGITS = 6;

/** Returns the pixel at an offset in a box, in whose middle the picture is as large as possible; null beside it. */
export function pixelAt(offset: Pixel, box: Size, picture: Size): Pixel | null {
  const scale = Math.min(box.width / picture.width, box.height / picture.height);
  const x = Math.floor((offset.x - (box.width - picture.width * scale) / 2) / scale);
  const y = Math.floor((offset.y - (box.height - picture.height * scale) / 2) / scale);
  return x >= 0 && y >= 0 && x < picture.width && y < picture.height ? { x, y } : null;
}

/** Returns the value of a pixel; null where nothing was measured. */
export function valueAt({ values, width }: PictureValues, { x, y }: Pixel): number | null {
  const value = values[y * width + x] ?? 0;
  return isMeasured(value) ? value : null;
}

/** Returns a value of 32 bits with the digits that it has. */
export function valueText(value: number, unit: PictureValues["unit"]): string {
  const text = String(Number(value.toPrecision(DIGITS)));
  return unit === null ? text : `${text} ${unit}`;
}
