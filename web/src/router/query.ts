// View state in the URL: filters, orders, tabs. So each view has a link, and the back button works.
import { computed, onScopeDispose, ref, watch, type Ref, type WritableComputedRef } from "vue";
import { useRoute, useRouter, type LocationQueryRaw, type Router } from "vue-router";

export type Way = "push" | "replace";

let isNavigating = false;
let pending: { readonly query: LocationQueryRaw; readonly way: Way; readonly path: string } | null = null;

/** Follows where a router goes, so that a late change of a view's address does not call one back who is leaving it. */
export function discardOnNavigation(router: Router): void {
  router.beforeEach((to, from) => {
    isNavigating = to.path !== from.path;
  });
  router.afterEach(() => {
    isNavigating = false;
  });
}

/** Changes one part of the address; changes of several parts at once become one step. */
function change(router: Router, name: string, value: string | readonly string[] | undefined, way: Way): void {
  const now = router.currentRoute.value;
  const isFirst = pending === null;
  const before = pending ?? { query: now.query, way: "replace" as const, path: now.path };
  pending = {
    query: { ...before.query, [name]: typeof value === "object" ? [...value] : value },
    way: way === "push" ? way : before.way,
    path: before.path,
  };
  if (!isFirst) return;
  setTimeout(() => {
    const changes = pending;
    pending = null;
    const route = router.currentRoute.value;
    if (changes === null || isNavigating || changes.path !== route.path) return;
    void router[changes.way]({ path: route.path, query: changes.query, hash: route.hash });
  });
}

/** Returns a part of the address as text. What equals `fallback` is not written there. */
export function useQueryText(name: string, fallback = "", way: Way = "replace"): WritableComputedRef<string> {
  const route = useRoute();
  const router = useRouter();
  return computed({
    get: () => {
      const value = route.query[name];
      return (Array.isArray(value) ? value[0] : value) ?? fallback;
    },
    set: (value) => change(router, name, value === fallback ? undefined : value, way),
  });
}

/** Returns a part of the address that may be there several times. */
export function useQueryList(name: string, way: Way = "replace"): WritableComputedRef<readonly string[]> {
  const route = useRoute();
  const router = useRouter();
  return computed({
    get: () => {
      const value = route.query[name];
      return (Array.isArray(value) ? value : [value]).filter((item): item is string => typeof item === "string");
    },
    set: (value) => change(router, name, value.length === 0 ? undefined : value, way),
  });
}

export interface Typed {
  readonly typed: Ref<string>;
  /** Submits the current text. */
  readonly apply: () => void;
  readonly onInput: () => void;
}

/** Returns what is typed; `text` becomes it after a pause. A text that comes from elsewhere takes its place. */
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
