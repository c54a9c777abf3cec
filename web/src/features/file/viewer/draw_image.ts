// Draws the picture of a message on a canvas.
import { coloured, type PictureValues, type Range } from "@/recordings/pictures/values";

type Image = ImageBitmap | PictureValues;

/** Returns the range of the values of a picture that has no colours of its own. */
export function rangeOf(image: Image): Range | null {
  return "values" in image ? image.range : null;
}

/** Returns the pixels of a picture, null where there are none. `table`: 256 colours for values of the range. */
export function pixelsOf(image: Image, range: Range | null, table: Uint8Array): ImageBitmap | ImageData | null {
  if (!("values" in image)) return image;
  return range === null ? null : new ImageData(coloured(image, range, table), image.width, image.height);
}

/** Draws pixels on a canvas, which takes the size of their picture. */
export function drawPixels(canvas: HTMLCanvasElement, { width, height }: Pick<Image, "width" | "height">, pixels: ImageBitmap | ImageData | null): void {
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d");
  if (pixels === null) return;
  if ("data" in pixels) context?.putImageData(pixels, 0, 0);
  else context?.drawImage(pixels, 0, 0);
}
