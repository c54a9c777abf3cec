// What a view is narrowed to stands in its address: filters, orders, tabs. So every view is a link, and back works.
import { computed, type WritableComputedRef } from "vue";
import { type LocationQueryRaw, type Router, useRoute, useRouter } from "vue-router";

export type Way = "push" | "replace";

let pending: { readonly query: LocationQueryRaw; readonly way: Way; readonly path: string } | null = null;

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
  queueMicrotask(() => {
    const wanted = pending;
    pending = null;
    const route = router.currentRoute.value;
    if (wanted === null || wanted.path !== route.path) return; // one has left the page meanwhile
    void router[wanted.way]({ path: route.path, query: wanted.query, hash: route.hash });
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
      return (Array.isArray(value) ? value : [value]).filter((each): each is string => typeof each === "string");
    },
    set: (value) => change(router, name, value.length === 0 ? undefined : value, way),
  });
}
