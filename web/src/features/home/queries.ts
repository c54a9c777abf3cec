// What home asks the server, and in a request of its own what all takes, which is slow to add up.
// Their keys begin as lists of missions do, since they are old when these are.
import { queryOptions, useQuery } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import type { components } from "@/api/schema";
import { useMe } from "@/api/session";

type Schemas = components["schemas"];
export type Home = Schemas["HomeRead"];
export type RecentMission = Schemas["RecentMission"];
export type UnfinishedUpload = Schemas["UnfinishedUpload"];
export type Attention = Schemas["Attention"];

export const homeQuery = queryOptions({
  queryKey: keys.missions({ home: true }),
  queryFn: ({ signal }) => call(api.GET("/api/v1/home", { signal })),
});

export function useHome() {
  return useQuery(homeQuery);
}

/** What is kept, by project. */
export function useHomeStorage() {
  return useQuery({
    queryKey: keys.missions({ home: "storage" }),
    queryFn: ({ signal }) => call(api.GET("/api/v1/home/storage", { signal })),
  });
}

/** Whether somebody without the power of an admin sees no project at all; undefined until that is known. */
export function useHasNoAccess(isAsked: () => boolean) {
  const { isAdmin } = useMe();
  const { data, isError } = useQuery({
    queryKey: keys.projects({ any: true }),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects", { params: { query: { limit: 1 } }, signal })),
    enabled: () => isAsked() && !isAdmin.value,
  });
  return computed(() => (isAdmin.value || isError.value ? false : data.value && data.value.items.length === 0));
}
