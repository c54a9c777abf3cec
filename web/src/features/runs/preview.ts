// What of an artifact can be shown, and how it is fetched: as bytes that this page makes something of. Pictures become
// pictures (an <img> runs nothing of an SVG), everything else text.
import { rowsOf } from "./csv";
import { addressOf } from "./queries";
import { type Track, trackOf } from "./track";
import type { Artifact } from "@/api/types";

const PICTURES: Readonly<Record<string, string>> = { png: "image/png", jpg: "image/jpeg", jpeg: "image/jpeg", svg: "image/svg+xml" };
const MOST_BYTES = 20_000_000;
const MOST_ROWS = 200;

export type Shown =
  | { readonly kind: "picture"; readonly address: string }
  | { readonly kind: "table"; readonly rows: readonly (readonly string[])[]; readonly count: number }
  | { readonly kind: "track"; readonly track: Track }
  | { readonly kind: "tooLarge" | "unknown" | "broken" };

function endingOf(path: string): string {
  return path.slice(path.lastIndexOf(".") + 1).toLowerCase();
}

async function read(artifact: Artifact, signal: AbortSignal): Promise<Blob> {
  const answer = await fetch(await addressOf(artifact), { signal, credentials: "omit" });
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

/** Returns what is shown of an artifact. Whoever shows a picture revokes its address. */
export async function previewOf(artifact: Artifact, signal: AbortSignal): Promise<Shown> {
  const ending = endingOf(artifact.path);
  const picture = PICTURES[ending];
  if (picture === undefined && !["csv", "geojson", "json"].includes(ending)) return { kind: "unknown" };
  if (artifact.size_bytes > MOST_BYTES) return { kind: "tooLarge" };
  const bytes = await read(artifact, signal);
  if (picture !== undefined) return { kind: "picture", address: URL.createObjectURL(new Blob([bytes], { type: picture })) };
  const text = await bytes.text();
  return ending === "csv" ? { kind: "table", ...rowsOf(text, MOST_ROWS + 1) } : drawn(text);
}
