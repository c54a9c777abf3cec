/** The picture of a message as the page draws it: a bitmap, or numbers that the page colours. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { stampOf } from "../geometry/values";
import { depthValues, rvlPixels } from "../pictures/compressed_depth";
import { greyPixels, isGreyPng } from "../pictures/grey_png";
import { checkCompressed, mimeOf, pictureOf, type Compressed, type Picture } from "../pictures/picture";
import { pixelsOf } from "../pictures/pixels";
import { pictureValues, type PictureValues } from "../pictures/values";

export interface DrawnPicture {
  image: ImageBitmap | PictureValues;
  width: number;
  height: number;
  /** How it is written: "image/jpeg", "rgb8" … */
  encoding: string;
  /** Of its header; null where there is none. */
  stampSeconds: number | null;
}

/** @throws ReadFailure not_a_picture, picture_unreadable, picture_too_large, pixels_unknown. */
export async function drawnPicture(value: Value): Promise<DrawnPicture> {
  const picture = pictureOf(value);
  const image = await imageOf(picture);
  const encoding = picture.kind === "compressed" ? picture.mime : picture.encoding;
  return { image, width: image.width, height: image.height, encoding, stampSeconds: stampOf(value) };
}

async function imageOf(picture: Picture): Promise<ImageBitmap | PictureValues> {
  if (picture.kind === "compressed") return compressedImage(picture);
  if (picture.kind === "raw") {
    const pixels = pixelsOf(picture);
    if ("values" in pixels) return pixels;
    return createImageBitmap(new ImageData(pixels.rgba, pixels.width, pixels.height));
  }
  if (picture.codec === "rvl") {
    const { width, height, pixels } = rvlPixels(picture.data);
    return depthValues(picture, width, height, pixels);
  }
  const png: Compressed = { kind: "compressed", mime: mimeOf(picture.data) ?? "image/png", data: picture.data };
  if (png.mime !== "image/png" || !isGreyPng(png.data)) return compressedImage(png);
  checkCompressed(png);
  const { width, height, pixels } = await greyPixels(png.data);
  return depthValues(picture, width, height, pixels);
}

async function compressedImage(picture: Compressed): Promise<ImageBitmap | PictureValues> {
  checkCompressed(picture);
  if (picture.mime === "image/png" && isGreyPng(picture.data)) {
    const { width, height, pixels } = await greyPixels(picture.data);
    return pictureValues(width, height, Float32Array.from(pixels), null);
  }
  try {
    return await createImageBitmap(new Blob([picture.data.slice()], { type: picture.mime }));
  } catch {
    throw new ReadFailure("picture_unreadable", picture.mime);
  }
}
