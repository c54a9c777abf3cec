// View state in the URL: filters, orders, tabs. So each view has a link, and the back button works.
import { computed, onScopeDispose, reactive, ref, watch, type ComputedRef, type Ref, type WritableComputedRef } from "vue";
import { useRoute, useRouter, type LocationQueryRaw, type Router } from "vue-router";

type HistoryChange = "push" | "replace";

let isNavigating = false;
/** The change that the router has not applied yet; later changes build on it. */
let applying: { readonly query: LocationQueryRaw; readonly path: string } | null = null;
let pending: { readonly query: LocationQueryRaw; readonly history: HistoryChange; readonly path: string } | null = null;

/** Tracks navigation, so that a late change of the URL does not return the user to a page that they are leaving. */
export function discardOnNavigation(router: Router): void {
  router.beforeEach((to, from) => {
    isNavigating = to.path !== from.path;
  });
  router.afterEach(() => {
    isNavigating = false;
  });
}

/** Changes one URL parameter. Changes of the same tick become one history entry. */
function change(router: Router, name: string, value: string | readonly string[] | undefined, history: HistoryChange): void {
  const now = router.currentRoute.value;
  const isFirst = pending === null;
  const query = applying?.path === now.path ? applying.query : now.query;
  const before = pending ?? { query, history: "replace" as const, path: now.path };
  pending = {
    query: { ...before.query, [name]: typeof value === "object" ? [...value] : value },
    history: history === "push" ? history : before.history,
    path: before.path,
  };
  if (!isFirst) return;
  setTimeout(() => {
    const changes = pending;
    pending = null;
    const route = router.currentRoute.value;
    if (changes === null || isNavigating || changes.path !== route.path) return;
    applying = changes;
    void router[changes.history]({ path: route.path, query: changes.query, hash: route.hash }).finally(() => {
      if (applying === changes) applying = null;
    });
  });
}

/** Returns a URL parameter as text. The URL omits a value that equals `fallback`. */
export function useQueryText(name: string, fallback = "", history: HistoryChange = "replace"): WritableComputedRef<string> {
  const route = useRoute();
  const router = useRouter();
  return computed({
    get: () => {
      const value = route.query[name];
      return (Array.isArray(value) ? value[0] : value) ?? fallback;
    },
    set: (value) => change(router, name, value === fallback ? undefined : value, history),
  });
}

/** Returns a URL parameter that can occur several times. */
export function useQueryList(name: string, history: HistoryChange = "replace"): WritableComputedRef<readonly string[]> {
  const route = useRoute();
  const router = useRouter();
  return computed({
    get: () => {
      const value = route.query[name];
      return (Array.isArray(value) ? value : [value]).filter((item): item is string => typeof item === "string");
    },
    set: (value) => change(router, name, value.length === 0 ? undefined : value, history),
  });
}

export interface Filters<Name extends string> {
  /** The values by name, to be read and written. */
  readonly values: Record<Name, string>;
  readonly isActive: ComputedRef<boolean>;
  readonly clear: () => void;
}

/** Returns the filters of a list, one URL parameter each. An empty value does not filter. */
export function useFilters<Name extends string>(...names: readonly Name[]): Filters<Name> {
  const values = reactive(Object.fromEntries(names.map((name) => [name, useQueryText(name)]))) as unknown as Record<Name, string>;
  return {
    values,
    isActive: computed(() => names.some((name) => values[name] !== "")),
    clear: () => {
      for (const name of names) values[name] = "";
    },
  };
}

export interface Typed {
  readonly typed: Ref<string>;
  /** Submits the current text. */
  readonly apply: () => void;
  readonly onInput: () => void;
}

/** Binds an input to `text`, which is updated after a pause in typing. A change of `text` by others replaces the input. */
export function useTyped(text: Ref<string>, pauseMs: number): Typed {
  const typed = ref(text.value);
  /** The last submitted text; the user may have typed more since. */
  let applied = text.value;
  let timer: ReturnType<typeof setTimeout> | undefined;

  watch(text, (value) => {
    if (value === applied) return;
    clearTimeout(timer);
    applied = typed.value = value;
  });

  function apply(): void {
    clearTimeout(timer);
    text.value = applied = typed.value.trim();
  }

  function onInput(): void {
    clearTimeout(timer);
    timer = setTimeout(apply, pauseMs);
  }

  onScopeDispose(() => clearTimeout(timer));
  return { typed, apply, onInput };
}
