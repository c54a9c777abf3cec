// The positions of missions.
import { keepPreviousData, useQuery } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { operations } from "@/api/schema";

export type PositionsQuery = NonNullable<operations["list_mission_positions"]["parameters"]["query"]>;

export function useMissionPositions(query: () => PositionsQuery) {
  return useQuery({
    queryKey: computed(() => keys.missionPositions(query())),
    queryFn: ({ signal }) => call(api.GET("/api/v1/mission-positions", { params: { query: query() }, signal })),
    placeholderData: keepPreviousData,
  });
}
