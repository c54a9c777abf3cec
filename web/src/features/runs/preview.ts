// Previews of artifacts. Their bytes are fetched by the page: pictures are shown in an <img>, which executes nothing of an
// SVG; everything else as text.
import { previewAddressOf, type PreviewArtifact, type Sample } from "./queries";

const PICTURES: Readonly<Record<string, string>> = { png: "image/png", jpg: "image/jpeg", jpeg: "image/jpeg", svg: "image/svg+xml" };
const MAX_BYTES = 20_000_000;
const MAX_ROWS = 200;

export type Shown =
  | { readonly kind: "picture"; readonly bytes: Blob }
  | { readonly kind: "table"; readonly rows: readonly (readonly string[])[]; readonly count: number }
  | { readonly kind: "track"; readonly track: Track }
  | { readonly kind: "tooLarge" | "unknown" | "broken" };

function endingOf(path: string): string {
  return path.slice(path.lastIndexOf(".") + 1).toLowerCase();
}

async function read(artifact: PreviewArtifact, signal: AbortSignal): Promise<Blob> {
  const answer = await fetch(await previewAddressOf(artifact), { signal, credentials: "omit" });
  if (!answer.ok) throw new Error(`the store answered ${answer.status}`);
  return answer.blob();
}

function drawn(text: string): Shown {
  try {
    const track = trackOf(JSON.parse(text));
    return track === null ? { kind: "broken" } : { kind: "track", track };
  } catch (thrown) {
    if (thrown instanceof SyntaxError) return { kind: "broken" };
    throw thrown;
  }
}

/** Returns bytes as a picture of the type that a path says, which an `<img>` shows. */
export function asPicture(bytes: Blob, path: string): Blob {
  return new Blob([bytes], { type: PICTURES[endingOf(path)] ?? "" });
}

/** Returns the preview of an artifact. */
export async function previewOf(artifact: PreviewArtifact, signal: AbortSignal): Promise<Shown> {
  const ending = endingOf(artifact.path);
  const isPicture = ending in PICTURES;
  if (!isPicture && !["csv", "geojson", "json"].includes(ending)) return { kind: "unknown" };
  if (artifact.size_bytes > MAX_BYTES) return { kind: "tooLarge" };
  const bytes = await read(artifact, signal);
  if (isPicture) return { kind: "picture", bytes: asPicture(bytes, artifact.path) };
  const text = await bytes.text();
  return ending === "csv" ? { kind: "table", ...rowsOf(text, MAX_ROWS + 1) } : drawn(text);
}

/** Returns the rows of a text, the first `most` of them, and how many there are. */
export function rowsOf(text: string, most: number): { readonly rows: readonly (readonly string[])[]; readonly count: number } {
  const rows: string[][] = [];
  let row: string[] = [];
  let count = 0;
  let at = text.startsWith("\ufeff") ? 1 : 0;

  function field(): string {
    if (text[at] !== '"') {
      const from = at;
      while (at < text.length && text[at] !== "," && text[at] !== "\n" && text[at] !== "\r") at += 1;
      return text.slice(from, at);
    }
    let value = "";
    at += 1;
    while (at < text.length) {
      const end = text.indexOf('"', at);
      value += text.slice(at, end < 0 ? text.length : end);
      at = end < 0 ? text.length : end + 1;
      if (text[at] !== '"') break;
      value += '"';
      at += 1;
    }
    return value;
  }

  while (at < text.length) {
    row.push(field());
    if (text[at] === ",") {
      at += 1;
      if (at < text.length) continue;
      row.push("");
    }
    if (text[at] === "\r") at += 1;
    if (text[at] === "\n") at += 1;
    count += 1;
    if (rows.length < most) rows.push(row);
    row = [];
  }
  return { rows, count };
}

export interface Track {
  /** Lines in metres, north up and y down, from the first point on. */
  readonly lines: readonly (readonly (readonly [number, number])[])[];
  readonly points: number;
  readonly box: { readonly x: number; readonly y: number; readonly width: number; readonly height: number };
}

type Position = readonly [number, number];

const METRES_PER_DEGREE = 111_320;
const MAX_POINTS = 20_000;
const DEEPEST = 8;

function isPosition(value: unknown): value is Position {
  return Array.isArray(value) && Number.isFinite(value[0]) && Number.isFinite(value[1]) && Math.abs(value[0] as number) <= 180 && Math.abs(value[1] as number) <= 90;
}

/** Collects the lines of a GeoJSON document in order; single points form one line. */
function collect(value: unknown, lines: Position[][], lone: Position[], depth: number): void {
  if (depth > DEEPEST || typeof value !== "object" || value === null) return;
  if (Array.isArray(value)) {
    const positions = value.filter(isPosition);
    if (positions.length > 0) lines.push(positions);
    else for (const item of value) collect(item, lines, lone, depth + 1);
    return;
  }
  const { type, geometry, geometries, features, coordinates } = value as Record<string, unknown>;
  if (type === "Point" && isPosition(coordinates)) lone.push(coordinates);
  else for (const item of [features, geometries, geometry, coordinates]) collect(item, lines, lone, depth + 1);
}

/** Returns what can be drawn of a document; null where there is nothing. */
export function trackOf(document: unknown): Track | null {
  const positions: Position[][] = [];
  const lone: Position[] = [];
  collect(document, positions, lone, 0);
  if (lone.length > 0 && positions.length === 0) positions.push(lone);
  const count = positions.reduce((sum, line) => sum + line.length, 0);
  const [origin] = positions[0] ?? [];
  if (origin === undefined) return null;
  const step = Math.ceil(count / MAX_POINTS);
  const narrowing = Math.cos((origin[1] * Math.PI) / 180);
  const lines = positions.map((line) =>
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

export interface Curve {
  readonly at: readonly number[];
  readonly values: readonly number[];
}

type Key = "cpu_s" | "memory_bytes" | "read_bytes" | "written_bytes";

/** Returns what was used at each moment. */
export function levels(samples: readonly Sample[], key: Key): Curve {
  return { at: samples.map((item) => item.at_s), values: samples.map((item) => item.usage[key]) };
}

/** Returns how fast a sum grew from moment to moment. */
export function rates(samples: readonly Sample[], key: Key): Curve {
  const at: number[] = [];
  const values: number[] = [];
  for (const [index, sample] of samples.entries()) {
    const before = samples[index - 1];
    if (before === undefined || sample.at_s <= before.at_s) continue;
    at.push(sample.at_s);
    values.push(Math.max(0, sample.usage[key] - before.usage[key]) / (sample.at_s - before.at_s));
  }
  return { at, values };
}

export function most({ values }: Curve): number {
  return values.reduce((high, value) => Math.max(high, value), 0);
}

/** Returns a curve as the outline of a filled area, in a box of 100 by 1. */
export function areaOf(curve: Curve): string {
  const [first, last] = [curve.at[0] ?? 0, curve.at.at(-1) ?? 0];
  const high = most(curve);
  if (curve.at.length === 0 || high === 0) return "";
  const x = (at: number) => (last === first ? 0 : (100 * (at - first)) / (last - first)).toFixed(2);
  const points = curve.at.map((at, index) => `L${x(at)} ${(1 - (curve.values[index] ?? 0) / high).toFixed(4)}`);
  const end = last === first ? `L100 ${(1 - (curve.values.at(-1) ?? 0) / high).toFixed(4)}` : "";
  return `M0 1${points.join("")}${end}L100 1Z`;
}
