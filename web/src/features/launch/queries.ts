// What the page that runs an action asks the server.
import { keepPreviousData, useQuery } from "@tanstack/vue-query";
import { computed, type ComputedRef } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import type { Mission } from "@/api/types";
import { globOf } from "@/components/glob";

const OFFERED = 8;
const MOST_TOPICS = 500;

/** The missions whose names hold what was typed. */
export function useMissionOffers(typed: () => string) {
  return useQuery({
    queryKey: ["missions", "offers", typed],
    queryFn: ({ signal }) => {
      const query = { limit: OFFERED, ...(typed() !== "" && { name: globOf(typed()) }) };
      return call(api.GET("/api/v1/missions", { params: { query }, signal }));
    },
    placeholderData: keepPreviousData,
  });
}

/** The missions that the address names; those that are gone, or not for the asker, are left out. */
export function useMissionsNamed(ids: () => readonly string[]) {
  return useQuery({
    queryKey: ["missions", "named", ids],
    queryFn: async ({ signal }): Promise<readonly Mission[]> => {
      const asked = ids().map((id) => call(api.GET("/api/v1/missions/{mission_id}", { params: { path: { mission_id: id } }, signal })));
      return (await Promise.allSettled(asked)).flatMap((each) => (each.status === "fulfilled" ? [each.value] : []));
    },
    placeholderData: keepPreviousData,
  });
}

/** The names of the topics of a mission. */
export function useTopicNames(missionId: () => string | undefined): ComputedRef<readonly string[]> {
  const found = useQuery({
    queryKey: computed(() => [...keys.mission(missionId() ?? ""), "topic-names"]),
    queryFn: ({ signal }) => {
      const params = { path: { mission_id: missionId() ?? "" }, query: { limit: MOST_TOPICS, bins: 0 } };
      return call(api.GET("/api/v1/missions/{mission_id}/topics", { params, signal }));
    },
    enabled: () => missionId() !== undefined,
  });
  return computed(() => [...new Set((found.data.value?.items ?? []).map(({ name }) => name))]);
}
