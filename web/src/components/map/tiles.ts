// The tiles of a map that a view needs.
//
// Source: the addresses of "slippy map" tiles, https://wiki.openstreetmap.org/wiki/Slippy_map_tilenames.
import type { MapView, Size } from "./map_view";

export interface TileSource {
  /** `{z}`, `{x}` and `{y}` stand for zoom, column and row. */
  readonly url: string;
  readonly max_zoom: number;
}

export interface Tile {
  readonly key: string;
  readonly url: string;
  /** Pixels in the area of the map. */
  readonly left: number;
  readonly top: number;
  readonly size: number;
}

const TILE_PX = 256;
const MAX_TILES = 200;

/** Returns the tiles that cover an area, enlarged ones where they would be too many; none where the world is too small for that. */
export function tilesOf(source: TileSource, view: MapView, size: Size): Tile[] {
  const nearest = Math.max(0, Math.min(source.max_zoom, Math.round(Math.log2(view.scale / TILE_PX))));
  for (let zoom = nearest; zoom >= 0; zoom -= 1) {
    const tiles = tilesAt(zoom, source, view, size);
    if (tiles !== null) return tiles;
  }
  return [];
}

/** Returns the tiles of a zoom; null for more than `MAX_TILES`. */
function tilesAt(zoom: number, { url }: TileSource, { centre, scale }: MapView, { width, height }: Size): Tile[] | null {
  const count = 2 ** zoom;
  const size = scale / count;
  const [left, top] = [centre.x * count - width / 2 / size, centre.y * count - height / 2 / size];
  const columns = numbersFrom(Math.floor(left), Math.floor(left + width / size));
  const rows = numbersFrom(Math.max(0, Math.floor(top)), Math.min(count - 1, Math.floor(top + height / size)));
  if (width <= 0 || height <= 0) return [];
  if (columns.length * rows.length > MAX_TILES) return null;
  return rows.flatMap((row) =>
    columns.map((column) => {
      const wrapped = ((column % count) + count) % count; // the world goes on at the date line
      const address = url.replace("{z}", String(zoom)).replace("{x}", String(wrapped)).replace("{y}", String(row));
      return { key: `${zoom}/${column}/${row}`, url: address, left: (column - left) * size, top: (row - top) * size, size };
    }),
  );
}

function numbersFrom(first: number, last: number): number[] {
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, at) => first + at);
}
