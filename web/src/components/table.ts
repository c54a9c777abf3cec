// Columns of a table: widths, visibility, order, keyboard navigation, selection.
import { computed, ref, watch, type ComputedRef, type WritableComputedRef } from "vue";

export interface Column<Row> {
  /** Also the name of the slot of its cells: `cell-KEY`. */
  readonly key: string;
  readonly title: string;
  /** A track of CSS grid; a column without one shares what room is left. */
  readonly width?: string;
  readonly align?: "left" | "right";
  /** The server's word for the order by this column; without one it cannot be sorted by. */
  readonly sort?: string;
  /** Shown only where the table is at least that wide. */
  readonly from?: "tablet" | "desktop";
  /** The text of a cell without a slot. */
  readonly text?: (row: Row) => string;
}

const OVERSCAN = 4;
/** Of a column that shares what room is left. */
const MIN_WIDTH = 80;
/** What boxes and the button for details take. */
const BESIDE = 80;
const WIDTHS = { tablet: 560, desktop: 900 } as const;

/** Returns the least width of a column, in pixels: the first number of its track. */
function leastWidth({ width }: Pick<Column<unknown>, "width">): number {
  return Math.max(MIN_WIDTH, Number(/\d+/.exec(width ?? "")?.[0] ?? 0));
}

/** Returns the columns that a table of some width shows. Columns with `from` go, the last ones first, where all do not fit. */
export function columnsFor<Row>(columns: readonly Column<Row>[], width: number): readonly Column<Row>[] {
  const fitting = columns.filter((column) => column.from === undefined || width >= WIDTHS[column.from]);
  let target = fitting.reduce((sum, column) => sum + leastWidth(column), 0);
  for (let at = fitting.length - 1; at > 0 && target > width - BESIDE; at -= 1) {
    const column = fitting[at];
    if (column?.from === undefined) continue;
    target -= leastWidth(column);
    fitting.splice(at, 1);
  }
  return fitting;
}

/** Returns the tracks of a table's grid. `hasDetails`: rows open to show the columns that have no room. */
export function tracks<Row>(columns: readonly Column<Row>[], isSelectable: boolean, hasDetails = false): string {
  const own = columns.map((column) => column.width ?? "minmax(0, 1fr)");
  return [...(isSelectable ? ["36px"] : []), ...own, ...(hasDetails ? ["44px"] : [])].join(" ");
}

const DETAIL_LINE = 30;
const DETAIL_EDGE = 12;

/** Returns how much higher an open row is, in pixels. */
export function heightOfDetails(lines: number): number {
  return lines === 0 ? 0 : lines * DETAIL_LINE + DETAIL_EDGE;
}

/** Returns the sort order after a click on a column title: ascending first, then descending. */
export function nextSort(now: string, column: string): string {
  return now === column ? `-${column}` : column;
}

/** Returns how a column is sorted, in ARIA's words. */
export function sortedAs(now: string, column: string | undefined): "ascending" | "descending" | "none" | undefined {
  if (column === undefined) return undefined;
  if (now === column) return "ascending";
  return now === `-${column}` ? "descending" : "none";
}

/** Returns the row that a key leads to from the active one; null for keys that lead nowhere. */
export function rowAfter(key: string, active: number, count: number, page: number): number | null {
  const steps: Readonly<Record<string, number>> = {
    ArrowDown: active + 1,
    ArrowUp: active - 1,
    PageDown: active + page,
    PageUp: active - page,
    Home: 0,
    End: count - 1,
  };
  const target = steps[key];
  return target === undefined || count === 0 ? null : Math.max(0, Math.min(count - 1, target));
}

/** Returns a selection after a click on a row; with shift, of all rows between this and the last one clicked. */
export function afterClick(
  selected: ReadonlySet<string>,
  keys: readonly string[],
  clicked: number,
  anchor: number | null,
): Set<string> {
  const result = new Set(selected);
  const key = keys[clicked];
  if (key === undefined) return result;
  const isAdding = !selected.has(key);
  const [from, to] = anchor === null ? [clicked, clicked] : [Math.min(anchor, clicked), Math.max(anchor, clicked)];
  for (const item of keys.slice(from, to + 1)) {
    if (isAdding) result.add(item);
    else result.delete(item);
  }
  return result;
}

/** Returns the rows of which something is to be seen from `top` on, some on both sides of these, and the one that is kept. */
export function inSight(top: number, height: number, rowHeight: number, count: number, pinned: number): readonly number[] {
  const last = Math.min(count - 1, Math.ceil((top + height) / rowHeight) - 1 + OVERSCAN);
  const first = Math.max(0, Math.min(last, Math.floor(top / rowHeight) - OVERSCAN));
  const rows: number[] = [];
  if (pinned < first && pinned < count) rows.push(pinned);
  for (let index = first; index <= last; index += 1) rows.push(index);
  if (pinned > last && pinned < count) rows.push(pinned);
  return rows;
}

/**
 * Returns the rows that a frame draws: of those wanted, the ones that are drawn already and at most `most` that come,
 * `first` and then the middle before the edges. A row that went stays until one comes in its place. The first time, all come.
 */
export function drawnAfter(before: readonly number[], target: readonly number[], first: number, most: number): readonly number[] {
  const middle = target[target.length >> 1] ?? 0;
  const urgency = (index: number) => (index === first ? -1 : Math.abs(index - middle));
  const coming = target.filter((index) => !before.includes(index)).sort((one, other) => urgency(one) - urgency(other));
  const drawn = coming.slice(0, before.length === 0 ? coming.length : most);
  const gone = before.filter((index) => !target.includes(index)).slice(0, coming.length - drawn.length);
  const staying = target.filter((index) => before.includes(index));
  return [...staying, ...drawn, ...gone].sort((one, other) => one - other);
}

/** Assigns an element to each rendered row: rows that stay keep theirs, new rows take those of rows that left. */
export function placesOf(indexes: readonly number[], before: ReadonlyMap<number, number>): ReadonlyMap<number, number> {
  const places = new Map<number, number>();
  for (const index of indexes) {
    const place = before.get(index);
    if (place !== undefined) places.set(index, place);
  }
  const taken = new Set(places.values());
  let free = 0;
  for (const index of indexes) {
    if (places.has(index)) continue;
    while (taken.has(free)) free += 1;
    places.set(index, free);
    free += 1;
  }
  return places;
}

export interface Columns<Row> {
  readonly shown: ComputedRef<readonly Column<Row>[]>;
  /** The keys of the columns that are shown beside the first one, which always is. */
  readonly chosen: WritableComputedRef<readonly string[]>;
  /** What can be chosen from. */
  readonly offered: ComputedRef<readonly Column<Row>[]>;
}

function read(key: string): readonly string[] | null {
  try {
    const stored: unknown = JSON.parse(localStorage.getItem(key) ?? "null");
    return Array.isArray(stored) ? stored.filter((item): item is string => typeof item === "string") : null;
  } catch {
    return null; // no storage, or an invalid value: the default columns are shown
  }
}

/** Returns the columns of the list called `name`. `usual` are the keys shown by default. */
export function useColumns<Row>(name: () => string, all: () => readonly Column<Row>[], usual: () => readonly string[]): Columns<Row> {
  const key = computed(() => `kleinkram-columns-${name()}`);
  const stored = ref(read(key.value));
  watch(key, (now) => (stored.value = read(now)));
  const chosen = computed({
    get: () => stored.value ?? usual(),
    set: (keys) => {
      stored.value = keys;
      try {
        localStorage.setItem(key.value, JSON.stringify(keys));
      } catch {
        return; // shown all the same, until the page is left
      }
    },
  });
  const offered = computed(() => all().slice(1));
  const shown = computed(() => {
    const target = new Set(chosen.value);
    return all().filter((column, at) => at === 0 || target.has(column.key));
  });
  return { shown, chosen, offered };
}
