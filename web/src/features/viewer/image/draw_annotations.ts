// Draws annotations over a picture, in its pixels.
import type { Annotation, CircleAnnotation, PathAnnotation, TextAnnotation } from "@/recordings/pictures/annotations";

export interface Style {
  /** Lines are at least as thick, so that they are seen where the picture is small on the screen. */
  readonly leastThickness: number;
  /** Of texts without a size. */
  readonly fontSize: number;
}

const LINES_PER_WIDTH = 500;
const TEXTS_PER_WIDTH = 32;
const MIN_FONT = 12;

/** Returns the style for a picture of a width. */
export function styleFor(width: number): Style {
  return { leastThickness: Math.max(1, width / LINES_PER_WIDTH), fontSize: Math.max(MIN_FONT, Math.round(width / TEXTS_PER_WIDTH)) };
}

/** Draws annotations in their order. */
export function drawAnnotations(context: CanvasRenderingContext2D, annotations: readonly Annotation[], style: Style): void {
  context.save();
  context.lineJoin = "round";
  for (const annotation of annotations) {
    if (annotation.kind === "text") drawText(context, annotation, style);
    else if (annotation.kind === "circle") drawCircle(context, annotation, style);
    else if (annotation.kind === "points") drawPoints(context, annotation, style);
    else drawLines(context, annotation, style);
  }
  context.restore();
}

function paint(context: CanvasRenderingContext2D, path: Path2D, fill: string | null, outline: string | null): void {
  if (fill !== null) {
    context.fillStyle = fill;
    context.fill(path);
  }
  if (outline !== null) {
    context.strokeStyle = outline;
    context.stroke(path);
  }
}

function circle(x: number, y: number, radius: number): Path2D {
  const path = new Path2D();
  path.arc(x, y, radius, 0, 2 * Math.PI);
  return path;
}

function drawCircle(context: CanvasRenderingContext2D, { x, y, radius, fill, outline, thickness }: CircleAnnotation, { leastThickness }: Style): void {
  context.lineWidth = Math.max(thickness, leastThickness);
  paint(context, circle(x, y, radius), fill, outline);
}

function drawPoints(context: CanvasRenderingContext2D, { places, outlines, thickness }: PathAnnotation, { leastThickness }: Style): void {
  const radius = Math.max(thickness, 2 * leastThickness) / 2;
  for (let at = 0; at < places.length; at += 2) {
    paint(context, circle(places[at] ?? 0, places[at + 1] ?? 0, radius), outlines[(at / 2) % outlines.length] ?? null, null);
  }
}

function drawLines(context: CanvasRenderingContext2D, { kind, places, outlines, fill, thickness }: PathAnnotation, { leastThickness }: Style): void {
  context.lineWidth = Math.max(thickness, leastThickness);
  const isClosed = kind === "loop";
  const [first = null] = outlines;
  const isOneColour = outlines.length === 1;
  if (kind !== "segments") paint(context, pathOf(places, isClosed), fill, isOneColour ? first : null);
  if (kind !== "segments" && isOneColour) return;
  const step = kind === "segments" ? 4 : 2;
  const count = places.length / 2;
  // Each line has the colour of the point where it begins.
  for (let at = 0, line = 0; at < places.length; at += step, line += 1) {
    const next = (at / 2 + 1) % count;
    if (next === 0 && !isClosed) break;
    const ends = [places[at], places[at + 1], places[2 * next], places[2 * next + 1]].map((place) => place ?? 0);
    paint(context, pathOf(ends, false), null, outlines[line % outlines.length] ?? null);
  }
}

function pathOf(places: readonly number[], isClosed: boolean): Path2D {
  const path = new Path2D();
  for (let at = 0; at < places.length; at += 2) path.lineTo(places[at] ?? 0, places[at + 1] ?? 0);
  if (isClosed) path.closePath();
  return path;
}

function drawText(context: CanvasRenderingContext2D, { x, y, text, size, colour, background }: TextAnnotation, { fontSize }: Style): void {
  const height = size ?? fontSize;
  const bottom = size === null ? Math.max(y, height) : y;
  context.font = `${height}px sans-serif`;
  context.textBaseline = "bottom";
  if (background !== null) {
    context.fillStyle = background;
    context.fillRect(x, bottom - height, context.measureText(text).width, height);
  }
  if (colour === null) return;
  context.fillStyle = colour;
  context.fillText(text, x, bottom);
}
