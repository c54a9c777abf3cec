// A search is its address: the same view with another text.
import { type RouteLocationRaw, useRoute } from "vue-router";

/** Returns what gives the address of this view with another text, or of another tab of it. */
export function useAddress(): (query: string, tab?: string) => RouteLocationRaw {
  const route = useRoute();
  return (query, tab) => ({
    name: "search",
    query: { ...route.query, ...(tab !== undefined && { tab }), q: query === "" ? undefined : query },
  });
}
