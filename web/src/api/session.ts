// The signed-in person and their permissions.
import { useQuery } from "@tanstack/vue-query";
import { computed, type ComputedRef } from "vue";
import { api, call, linkSecret, noteSignedIn } from "./client";
import { keys } from "./queries";
import { Problem } from "./problem";
import type { Me, Service } from "./types";

/** Returns who is signed in; null for a stranger, and for a page that reads with a share link. */
export async function fetchMe(): Promise<Me | null> {
  if (linkSecret() !== null) return null;
  try {
    const me = await call(api.GET("/api/v1/me"));
    noteSignedIn(true);
    return me;
  } catch (thrown) {
    if (thrown instanceof Problem && thrown.code === "not_authenticated") return null;
    throw thrown;
  }
}

export const meQuery = { queryKey: keys.me, queryFn: fetchMe, staleTime: 5 * 60_000 } as const;

export interface CurrentUser {
  /** Null for a stranger, and while it is not known yet. */
  readonly me: ComputedRef<Me | null>;
  readonly isAdmin: ComputedRef<boolean>;
  readonly isKnown: ComputedRef<boolean>;
}

/** Returns who is here, kept current. */
export function useMe(): CurrentUser {
  const query = useQuery(meQuery);
  return {
    me: computed(() => query.data.value ?? null),
    isAdmin: computed(() => query.data.value?.is_admin ?? false),
    isKnown: computed(() => !query.isPending.value),
  };
}

/** Returns the server's description of itself: name, store, viewers. Null until it is loaded. */
export function useService(): ComputedRef<Service | null> {
  const query = useQuery({ queryKey: keys.service, queryFn: () => call(api.GET("/api/v1/service")), staleTime: Infinity });
  return computed(() => query.data.value ?? null);
}
