// A track that a run left as GeoJSON, drawn from its numbers alone: nothing else of the document is shown.
export interface Track {
  /** Lines in metres, north up and y down, from the first point on. */
  readonly lines: readonly (readonly (readonly [number, number])[])[];
  readonly points: number;
  readonly box: { readonly x: number; readonly y: number; readonly width: number; readonly height: number };
}

type Position = readonly [number, number];

const METRES_PER_DEGREE = 111_320;
const MOST_POINTS = 20_000;
const DEEPEST = 8;

function isPosition(value: unknown): value is Position {
  return Array.isArray(value) && Number.isFinite(value[0]) && Number.isFinite(value[1]) && Math.abs(value[0] as number) <= 180 && Math.abs(value[1] as number) <= 90;
}

/** Collects the lines of whatever stands in the document, in order; lone points follow each other as one line. */
function collect(value: unknown, lines: Position[][], lone: Position[], depth: number): void {
  if (depth > DEEPEST || typeof value !== "object" || value === null) return;
  if (Array.isArray(value)) {
    const positions = value.filter(isPosition);
    if (positions.length > 0) lines.push(positions);
    else for (const each of value) collect(each, lines, lone, depth + 1);
    return;
  }
  const { type, geometry, geometries, features, coordinates } = value as Record<string, unknown>;
  if (type === "Point" && isPosition(coordinates)) lone.push(coordinates);
  else for (const each of [features, geometries, geometry, coordinates]) collect(each, lines, lone, depth + 1);
}

/** Returns what can be drawn of a document; null where there is nothing. */
export function trackOf(document: unknown): Track | null {
  const found: Position[][] = [];
  const lone: Position[] = [];
  collect(document, found, lone, 0);
  if (lone.length > 0 && found.length === 0) found.push(lone);
  const count = found.reduce((sum, line) => sum + line.length, 0);
  const [origin] = found[0] ?? [];
  if (origin === undefined) return null;
  const step = Math.ceil(count / MOST_POINTS);
  const narrowing = Math.cos((origin[1] * Math.PI) / 180);
  const lines = found.map((line) =>
    line
      .filter((_, at) => at % step === 0 || at === line.length - 1)
      .map(([longitude, latitude]) => [(longitude - origin[0]) * METRES_PER_DEGREE * narrowing, (origin[1] - latitude) * METRES_PER_DEGREE] as const),
  );
  return { lines, points: count, box: boxOf(lines.flat()) };
}

function boxOf(points: readonly (readonly [number, number])[]): Track["box"] {
  let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
  for (const [x, y] of points) {
    [left, right] = [Math.min(left, x), Math.max(right, x)];
    [top, bottom] = [Math.min(top, y), Math.max(bottom, y)];
  }
  const margin = Math.max(right - left, bottom - top, 1) * 0.06;
  return { x: left - margin, y: top - margin, width: right - left + 2 * margin, height: bottom - top + 2 * margin };
}

/** Returns a round length in metres of about a fifth of a width, for a scale. */
export function scaleOf(width: number): number {
  const power = 10 ** Math.floor(Math.log10(width / 5));
  const steps = width / 5 / power;
  return (steps >= 5 ? 5 : steps >= 2 ? 2 : 1) * power;
}
