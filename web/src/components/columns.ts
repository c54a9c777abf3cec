// Which columns of a list somebody wants to see, remembered by this browser.
import { computed, type ComputedRef, ref, watch, type WritableComputedRef } from "vue";
import type { Column } from "./table";

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
    return Array.isArray(stored) ? stored.filter((each): each is string => typeof each === "string") : null;
  } catch {
    return null; // no storage, or not what was written: the usual columns are shown
  }
}

/** Returns the columns of the list called `name`. `usual` are the keys that are shown until somebody chooses. */
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
    const wanted = new Set(chosen.value);
    return all().filter((column, at) => at === 0 || wanted.has(column.key));
  });
  return { shown, chosen, offered };
}
