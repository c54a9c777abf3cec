// What a view is narrowed to stands in its address: filters, orders, tabs. So every view is a link, and back works.
import { computed, type WritableComputedRef } from "vue";
import { useRoute, useRouter, type LocationQueryRaw, type Router } from "vue-router";

export type Way = "push" | "replace";

let isLeaving = false;
let pending: { readonly query: LocationQueryRaw; readonly way: Way; readonly path: string } | null = null;

/** Follows where a router goes, so that a late change of a view's address does not call one back who is leaving it. */
export function followLeaving(router: Router): void {
  router.beforeEach((to, from) => {
    isLeaving = to.path !== from.path;
  });
  router.afterEach(() => {
    isLeaving = false;
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
    const wanted = pending;
    pending = null;
    const route = router.currentRoute.value;
    if (wanted === null || isLeaving || wanted.path !== route.path) return;
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
      return (Array.isArray(value) ? value : [value]).filter((item): item is string => typeof item === "string");
    },
    set: (value) => change(router, name, value.length === 0 ? undefined : value, way),
  });
}
