// Draws the picture of a message on a canvas.
import { coloured, type PictureValues, type Range } from "@/recordings/pictures/values";

type Image = ImageBitmap | PictureValues;

/** Returns the range of the values of a picture that has no colours of its own. */
export function rangeOf(image: Image): Range | null {
  return "values" in image ? image.range : null;
}

/** Draws a picture on a canvas, which takes its size. `table`: 256 colours for values of the range. */
export function drawImage(canvas: HTMLCanvasElement, image: Image, range: Range | null, table: Uint8Array): void {
  canvas.width = image.width;
  canvas.height = image.height;
  const context = canvas.getContext("2d");
  if (!("values" in image)) context?.drawImage(image, 0, 0);
  else if (range !== null) context?.putImageData(new ImageData(coloured(image, range, table), image.width, image.height), 0, 0);
}
