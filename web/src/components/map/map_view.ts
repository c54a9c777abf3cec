// The view of a map: Web Mercator, zoom, and the scale bar. Works without tiles.
//
// Source: EPSG:3857 (spherical Mercator); distances with the radius of the WGS 84 equator.
import type { Position } from "@/recordings/products/location";

/** A place on the map: the world is a square from 0 to 1, x to the east, y to the south. */
export interface WorldPoint {
  readonly x: number;
  readonly y: number;
}

export interface MapView {
  readonly centre: WorldPoint;
  /** Pixels of the whole world. */
  readonly scale: number;
}

export interface Pixel {
  readonly left: number;
  readonly top: number;
}

export interface Size {
  readonly width: number;
  readonly height: number;
}

export const EQUATOR_M = 2 * Math.PI * 6_378_137;
/** Mercator ends here. */
const MAX_LATITUDE = 85.051_128_78;
/** A view of tracks shows at least so many metres. */
const MIN_EXTENT_M = 20;
const MARGIN = 0.85;
const MIN_SCALE = 64;
/** A pixel is then a tenth of a millimetre. */
const MAX_SCALE = EQUATOR_M * 10_000;
const RAD = Math.PI / 180;

/** Returns the place of a position; near `anchorX`, so that a track across the date line stays in one piece. */
export function worldPoint({ latitude, longitude }: Pick<Position, "latitude" | "longitude">, anchorX?: number): WorldPoint {
  const bounded = Math.max(-MAX_LATITUDE, Math.min(MAX_LATITUDE, latitude)) * RAD;
  const x = longitude / 360 + 0.5;
  const y = 0.5 - Math.asinh(Math.tan(bounded)) / (2 * Math.PI);
  return { x: anchorX === undefined ? x : x - Math.round(x - anchorX), y };
}

/** Returns the latitude of a place in degrees. */
export function latitudeOf({ y }: WorldPoint): number {
  return Math.atan(Math.sinh((0.5 - y) * 2 * Math.PI)) / RAD;
}

/** Returns the longitude of a place in degrees, from -180 to 180. */
export function longitudeOf({ x }: WorldPoint): number {
  return (x - Math.floor(x) - 0.5) * 360;
}

/** Returns how many metres a pixel is at the centre of a view. */
export function metresPerPixel({ centre, scale }: MapView): number {
  return (EQUATOR_M * Math.cos(latitudeOf(centre) * RAD)) / scale;
}

export function toPixels({ centre, scale }: MapView, { width, height }: Size, { x, y }: WorldPoint): Pixel {
  return { left: (x - centre.x) * scale + width / 2, top: (y - centre.y) * scale + height / 2 };
}

/** Returns the view that shows all places. */
export function fitted(places: readonly WorldPoint[], { width, height }: Size): MapView {
  const [first = { x: 0.5, y: 0.5 }] = places;
  let [left, right, top, bottom] = [first.x, first.x, first.y, first.y];
  for (const { x, y } of places) {
    [left, right] = [Math.min(left, x), Math.max(right, x)];
    [top, bottom] = [Math.min(top, y), Math.max(bottom, y)];
  }
  const centre = { x: (left + right) / 2, y: (top + bottom) / 2 };
  const least = MIN_EXTENT_M / (EQUATOR_M * Math.cos(latitudeOf(centre) * RAD));
  const scale = Math.min(width / Math.max(right - left, least), height / Math.max(bottom - top, least)) * MARGIN;
  return { centre, scale: bounded(scale) };
}

/** Returns the view zoomed around a pixel, which keeps its place. */
export function zoomed({ centre, scale }: MapView, factor: number, { width, height }: Size, { left, top }: Pixel): MapView {
  const next = bounded(scale * factor);
  const shift = 1 / scale - 1 / next;
  return { centre: { x: centre.x + (left - width / 2) * shift, y: centre.y + (top - height / 2) * shift }, scale: next };
}

export function panned({ centre, scale }: MapView, byLeft: number, byTop: number): MapView {
  return { centre: { x: centre.x - byLeft / scale, y: Math.max(0, Math.min(1, centre.y - byTop / scale)) }, scale };
}

function bounded(scale: number): number {
  return Math.max(MIN_SCALE, Math.min(MAX_SCALE, scale));
}

export interface ScaleBar {
  readonly metres: number;
  readonly pixels: number;
}

/** Returns the longest bar of 1, 2 or 5 times a power of ten that fits. */
export function scaleBar(view: MapView, maxPixels: number): ScaleBar {
  const perPixel = metresPerPixel(view);
  const longest = perPixel * maxPixels;
  const power = 10 ** Math.floor(Math.log10(longest));
  const metres = [5, 2, 1].map((step) => step * power).find((length) => length <= longest) ?? power;
  return { metres, pixels: metres / perPixel };
}

/** Returns the lines of a grid through an anchor, by their pixels. */
export function gridLines(view: MapView, size: Size, anchor: WorldPoint, pixels: number): { readonly lefts: readonly number[]; readonly tops: readonly number[] } {
  const { left, top } = toPixels(view, size, anchor);
  const lines = (origin: number, length: number): number[] => {
    const first = ((origin % pixels) + pixels) % pixels;
    return Array.from({ length: Math.max(0, Math.ceil((length - first) / pixels)) }, (_, number) => first + number * pixels);
  };
  return { lefts: lines(left, size.width), tops: lines(top, size.height) };
}

/** A place of a line, and whether it begins a new one. */
export interface LinePlace extends WorldPoint {
  readonly isStart: boolean;
}

/** Points nearer than this to the one before are not drawn. */
const MIN_STEP_PX = 0.7;
/** What is far outside is drawn there: a longer path would be slow. */
const OUTSIDE_PX = 20_000;

/** Returns the path of lines for SVG. */
export function linePath(view: MapView, size: Size, places: readonly LinePlace[]): string {
  const steps: string[] = [];
  let [lastLeft, lastTop] = [Number.NaN, Number.NaN];
  const within = (pixel: number): number => Math.max(-OUTSIDE_PX, Math.min(OUTSIDE_PX, pixel));
  for (const [number, place] of places.entries()) {
    const { left, top } = toPixels(view, size, place);
    const isLast = places[number + 1]?.isStart ?? true;
    if (!place.isStart && !isLast && Math.hypot(left - lastLeft, top - lastTop) < MIN_STEP_PX) continue;
    [lastLeft, lastTop] = [left, top];
    steps.push(`${place.isStart ? "M" : "L"}${within(left).toFixed(1)} ${within(top).toFixed(1)}`);
  }
  return steps.join("");
}

/** Returns the place that is nearest to a pixel; null where none is within `maxPixels`. */
export function nearest<Place extends WorldPoint>(view: MapView, size: Size, places: readonly Place[], at: Pixel, maxPixels: number): Place | null {
  let best: Place | null = null;
  let bestPixels = maxPixels;
  for (const place of places) {
    const { left, top } = toPixels(view, size, place);
    const pixels = Math.hypot(left - at.left, top - at.top);
    if (pixels <= bestPixels) [best, bestPixels] = [place, pixels];
  }
  return best;
}
