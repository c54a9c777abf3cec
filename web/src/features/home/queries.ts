// What home asks the server, in one request. Its key begins as lists of missions do, since it is old when they are.
import { queryOptions, useQuery } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import type { components } from "@/api/schema";

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
