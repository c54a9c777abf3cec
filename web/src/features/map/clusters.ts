// Places that are near each other on the screen are one cluster.
import { EQUATOR_M, latitudeOf, type WorldPoint } from "@/components/map/map_view";

export interface Cluster<Place extends WorldPoint> extends WorldPoint {
  readonly members: readonly Place[];
}

/** Places nearer than this are in one cluster. */
const RADIUS_PX = 36;

interface Group<Place> {
  /** The first member. */
  readonly anchor: WorldPoint;
  readonly members: Place[];
}

/** Returns the places in clusters, each in their middle. Moving the map does not change them, nor does a little zoom.
 *
 * `scale`: pixels of the whole world. Takes time in proportion to the number of places.
 */
export function clustersOf<Place extends WorldPoint>(places: readonly Place[], scale: number): Cluster<Place>[] {
  const radius = RADIUS_PX / 2 ** Math.round(Math.log2(scale));
  const cells = new Map<string, Group<Place>[]>();
  const groups: Group<Place>[] = [];
  for (const place of places) {
    const [column, row] = [Math.floor(place.x / radius), Math.floor(place.y / radius)];
    const near = around(cells, column, row).find(({ anchor }) => Math.hypot(anchor.x - place.x, anchor.y - place.y) <= radius);
    if (near !== undefined) {
      near.members.push(place);
      continue;
    }
    const group = { anchor: place, members: [place] };
    groups.push(group);
    const key = `${column} ${row}`;
    cells.set(key, [...(cells.get(key) ?? []), group]);
  }
  return groups.map(({ members }) => ({ ...middleOf(members), members }));
}

function around<Place>(cells: ReadonlyMap<string, Group<Place>[]>, column: number, row: number): Group<Place>[] {
  return [-1, 0, 1].flatMap((right) => [-1, 0, 1].flatMap((down) => cells.get(`${column + right} ${row + down}`) ?? []));
}

function middleOf(members: readonly WorldPoint[]): WorldPoint {
  const sum = members.reduce((total, { x, y }) => ({ x: total.x + x, y: total.y + y }), { x: 0, y: 0 });
  return { x: sum.x / members.length, y: sum.y / members.length };
}

/** Returns how far apart the members of a cluster are at most, in metres east-west or north-south. */
export function extentOf({ x, y, members }: Cluster<WorldPoint>): number {
  const spread = (values: readonly number[]): number => Math.max(...values) - Math.min(...values);
  const share = Math.max(spread(members.map((member) => member.x)), spread(members.map((member) => member.y)));
  return share * EQUATOR_M * Math.cos((latitudeOf({ x, y }) * Math.PI) / 180);
}
