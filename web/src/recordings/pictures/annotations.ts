/** What is drawn over a picture, in its pixels: the origin is the top left corner of the top left pixel.
 *
 * Sources: foxglove.ImageAnnotations; vision_msgs/Detection2DArray of ROS 1 and ROS 2.
 */

import type { Value } from "../decoding/decoder";
import { colourOf, listOf, numberOf, part, secondsOf, stampOf, textOf, type Colour } from "../geometry/values";
import { MAX_ANNOTATION_POINTS } from "../limits";

/** A colour of CSS; null where nothing is drawn. */
type Paint = string | null;

export interface PathAnnotation {
  kind: "points" | "loop" | "strip" | "segments";
  /** x and y of each point. */
  places: number[];
  /** One for all, or one for each point; for segments, for each pair. */
  outlines: Paint[];
  fill: Paint;
  thickness: number;
}

export interface CircleAnnotation {
  kind: "circle";
  x: number;
  y: number;
  radius: number;
  outline: Paint;
  fill: Paint;
  thickness: number;
}

/** A text whose bottom left corner is at a place. */
export interface TextAnnotation {
  kind: "text";
  x: number;
  y: number;
  text: string;
  /** Height of the font; null for one that can be read in a picture of any size. */
  size: number | null;
  colour: Paint;
  background: Paint;
}

export type Annotation = PathAnnotation | CircleAnnotation | TextAnnotation;

export interface Annotations {
  stampSeconds: number | null;
  annotations: Annotation[];
  /** Points that are left out because there are too many. */
  omittedPoints: number;
}

type Add = (collector: Collector, message: Value) => void;

/** By type without `msg/`. */
const SHOWN: Readonly<Record<string, Add>> = {
  "foxglove.ImageAnnotations": addImageAnnotations,
  "vision_msgs/Detection2DArray": (collector, message) => listOf(part(message, "detections")).forEach((one) => addDetection(collector, one)),
  "vision_msgs/Detection2D": addDetection,
};
const MAX_TEXT = 200;
const MAX_THICKNESS = 500;
const MAX_FONT = 1_000;
const OUTLINE = "#00ff00";
/** Of classes; they differ in lightness, too. */
const CLASS_COLOURS = ["#00ff00", "#ffd400", "#00d5ff", "#ff5cf4", "#ff8c1a", "#a6ff4d", "#ff5c5c", "#9fb7ff"] as const;
const KINDS = ["points", "points", "loop", "strip", "segments"] as const;
const KIND_NAMES: Readonly<Record<string, PathAnnotation["kind"]>> = { POINTS: "points", LINE_LOOP: "loop", LINE_STRIP: "strip", LINE_LIST: "segments" };

function addOf(messageType: string): Add | undefined {
  const name = messageType.replace("/msg/", "/").replace(/^foxglove_msgs\//, "foxglove.");
  return Object.hasOwn(SHOWN, name) ? SHOWN[name] : undefined;
}

/** Whether messages of a type are drawn over pictures. */
export function isAnnotationType(messageType: string | null): boolean {
  return messageType !== null && addOf(messageType) !== undefined;
}

/** Return what a message draws over a picture; nothing for other types. What has no finite place is left out. */
export function annotationsOf(messageType: string, message: Value): Annotations {
  const collector = new Collector();
  addOf(messageType)?.(collector, message);
  return { stampSeconds: stampOf(message) ?? firstStamp(message), annotations: collector.annotations, omittedPoints: collector.omittedPoints };
}

/** Messages without a header have their time in each annotation. */
function firstStamp(message: Value): number | null {
  const first = ["points", "circles", "texts"].flatMap((name) => listOf(part(message, name)).slice(0, 1))[0];
  const seconds = secondsOf(part(first, "timestamp"));
  return seconds > 0 ? seconds : null;
}

class Collector {
  readonly annotations: Annotation[] = [];
  omittedPoints = 0;
  private pointsLeft = MAX_ANNOTATION_POINTS;

  /** Return how many of so many points may be added. */
  take(points: number): number {
    const taken = Math.min(points, this.pointsLeft);
    this.pointsLeft -= taken;
    this.omittedPoints += points - taken;
    return taken;
  }

  add(annotation: Annotation): void {
    this.annotations.push(annotation);
  }
}

function addImageAnnotations(collector: Collector, message: Value): void {
  for (const one of listOf(part(message, "points"))) addPath(collector, one);
  for (const one of listOf(part(message, "circles"))) addCircle(collector, one);
  for (const one of listOf(part(message, "texts"))) addText(collector, one);
}

function addPath(collector: Collector, path: Value): void {
  const kind = kindOf(part(path, "type"));
  const all = listOf(part(path, "points"));
  const colours = listOf(part(path, "outline_colors"));
  const places: number[] = [];
  const outlines: Paint[] = [];
  const hasOwnColours = colours.length === (kind === "segments" ? all.length >> 1 : all.length);
  for (let at = 0, end = collector.take(all.length); at < end; at += 1) {
    const [x, y] = placeOf(all[at] ?? null);
    // A segment without one of its ends would join two others.
    const isDropped = kind === "segments" ? !isWholeSegment(all, at, end) : !isFinitePlace(x, y);
    if (isDropped) continue;
    places.push(x, y);
    if (hasOwnColours && (kind !== "segments" || at % 2 === 0)) outlines.push(paintOf(colours[kind === "segments" ? at >> 1 : at], OUTLINE));
  }
  if (places.length === 0) return;
  const outline = paintOf(part(path, "outline_color"), OUTLINE);
  collector.add({ kind, places, outlines: hasOwnColours && outlines.length > 0 ? outlines : [outline], fill: paintOf(part(path, "fill_color"), null), thickness: thicknessOf(path) });
}

function isWholeSegment(points: readonly Value[], at: number, end: number): boolean {
  const first = at - (at % 2);
  return first + 1 < end && isFinitePlace(...placeOf(points[first] ?? null)) && isFinitePlace(...placeOf(points[first + 1] ?? null));
}

function addCircle(collector: Collector, circle: Value): void {
  const [x, y] = placeOf(part(circle, "position"));
  const radius = numberOf(part(circle, "diameter")) / 2;
  if (!isFinitePlace(x, y) || !(Number.isFinite(radius) && radius >= 0) || collector.take(1) === 0) return;
  const [outline, fill] = [paintOf(part(circle, "outline_color"), OUTLINE), paintOf(part(circle, "fill_color"), null)];
  collector.add({ kind: "circle", x, y, radius, outline, fill, thickness: thicknessOf(circle) });
}

function addText(collector: Collector, text: Value): void {
  const [x, y] = placeOf(part(text, "position"));
  if (!isFinitePlace(x, y) || collector.take(1) === 0) return;
  const size = numberOf(part(text, "font_size"));
  const [colour, background] = [paintOf(part(text, "text_color"), "#ffffff"), paintOf(part(text, "background_color"), null)];
  collector.add({ kind: "text", x, y, text: textOf(part(text, "text")).slice(0, MAX_TEXT), size: size > 0 ? Math.min(size, MAX_FONT) : null, colour, background });
}

/** A box with the class that has the greatest score. */
function addDetection(collector: Collector, detection: Value): void {
  const box = part(detection, "bbox");
  const centre = part(box, "center");
  const [x, y] = placeOf(part(centre, "position") ?? centre);
  const [halfWidth, halfHeight] = [numberOf(part(box, "size_x")) / 2, numberOf(part(box, "size_y")) / 2];
  if (![x, y, halfWidth, halfHeight].every(Number.isFinite) || collector.take(4) < 4) return;
  const angle = numberOf(part(centre, "theta"));
  const [cosine, sine] = Number.isFinite(angle) ? [Math.cos(angle), Math.sin(angle)] : [1, 0];
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]] as const;
  const places = corners.flatMap(([right, down]) => {
    const [along, across] = [right * halfWidth, down * halfHeight];
    return [x + along * cosine - across * sine, y + along * sine + across * cosine];
  });
  const { label, colour } = bestClass(listOf(part(detection, "results")));
  collector.add({ kind: "loop", places, outlines: [colour], fill: null, thickness: 2 });
  if (label === "" || collector.take(1) === 0) return;
  const [left, top] = [0, 1].map((axis) => Math.min(...places.filter((_, at) => at % 2 === axis))) as [number, number];
  collector.add({ kind: "text", x: left, y: top, text: label, size: null, colour: "#000000", background: colour });
}

function bestClass(results: readonly Value[]): { label: string; colour: string } {
  const candidates = results.map((result) => {
    const hypothesis = part(result, "hypothesis") ?? result;
    const id = part(hypothesis, "class_id") ?? part(hypothesis, "id");
    const score = numberOf(part(hypothesis, "score"));
    return { name: typeof id === "number" ? String(id) : textOf(id).slice(0, MAX_TEXT), score };
  });
  const [best] = candidates.toSorted((a, b) => (Number.isNaN(b.score) ? -1 : Number.isNaN(a.score) ? 1 : b.score - a.score));
  if (best === undefined) return { label: "", colour: CLASS_COLOURS[0] };
  const sum = Array.from(best.name).reduce((total, letter) => total + (letter.codePointAt(0) ?? 0), 0);
  const score = Number.isNaN(best.score) ? "" : best.score.toFixed(2);
  return { label: `${best.name} ${score}`.trim(), colour: CLASS_COLOURS[sum % CLASS_COLOURS.length] ?? OUTLINE };
}

/** A number, or its name as JSON can have it. */
function kindOf(type: Value): PathAnnotation["kind"] {
  if (typeof type === "string") return KIND_NAMES[type] ?? "points";
  return KINDS[numberOf(type)] ?? "points";
}

function placeOf(point: Value): [x: number, y: number] {
  return [numberOf(part(point, "x")), numberOf(part(point, "y"))];
}

function isFinitePlace(x: number, y: number): boolean {
  return Number.isFinite(x) && Number.isFinite(y);
}

function thicknessOf(annotation: Value): number {
  const thickness = numberOf(part(annotation, "thickness"));
  return thickness > 0 ? Math.min(thickness, MAX_THICKNESS) : 1;
}

function paintOf(colour: Value | undefined, otherwise: Paint): Paint {
  return colour === undefined || colour === null ? otherwise : cssColour(colourOf(colour));
}

function cssColour([red, green, blue, alpha]: Colour): Paint {
  const [r, g, b] = [red, green, blue].map((share) => Math.round(share * 255));
  return alpha === 0 ? null : `rgb(${r} ${g} ${b} / ${alpha})`;
}
