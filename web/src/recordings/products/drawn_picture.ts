/** The picture of a message as a bitmap. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { checkCompressed, pictureOf } from "../pictures/picture";
import { pixelsOf } from "../pictures/pixels";

export interface DrawnPicture {
  bitmap: ImageBitmap;
  width: number;
  height: number;
  /** How it is written: "image/jpeg", "rgb8" … */
  encoding: string;
  /** The values that became black and white, where they were chosen by what the picture holds. */
  range: [number, number] | null;
}

/** @throws ReadFailure not_a_picture, picture_unreadable, picture_too_large, pixels_unknown. */
export async function drawnPicture(value: Value): Promise<DrawnPicture> {
  const picture = pictureOf(value);
  if (picture.kind === "raw") {
    const { width, height, rgba, range } = pixelsOf(picture);
    const bitmap = await createImageBitmap(new ImageData(rgba, width, height));
    return { bitmap, width, height, encoding: picture.encoding, range };
  }
  checkCompressed(picture);
  let bitmap: ImageBitmap;
  try {
    bitmap = await createImageBitmap(new Blob([picture.data.slice()], { type: picture.mime }));
  } catch {
    throw new ReadFailure("picture_unreadable", picture.mime);
  }
  return { bitmap, width: bitmap.width, height: bitmap.height, encoding: picture.mime, range: null };
}
