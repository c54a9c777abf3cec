// Queries and mutations of the events of a mission, and the findings of its runs that have a time.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import type { EventChange, FindingWithTime, MissionEvent, NewEvent } from "./events";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys } from "@/api/queries";

const PAGE = 500;
/** The server allows 10,000 events of a mission. Of findings, there may be more. */
export const MAX_FINDINGS = 2000;
/** Missions that one request names at most. */
const MAX_MISSIONS = 50;

/** All events of a mission, by start. */
export function useMissionEvents(missionId: () => string) {
  return useQuery({
    queryKey: computed(() => keys.missionEvents({ mission_id: missionId() })),
    queryFn: async ({ signal }): Promise<readonly MissionEvent[]> => {
      const events: MissionEvent[] = [];
      for (let cursor: string | null | undefined; cursor !== null; ) {
        const query = { mission_id: missionId(), limit: PAGE, ...(cursor && { cursor }) };
        const page = await call(api.GET("/api/v1/mission-events", { params: { query }, signal }));
        events.push(...page.items);
        cursor = page.next ?? null;
      }
      return events;
    },
  });
}

/** The number of events of a mission. */
export function useEventCount(missionId: string) {
  return useQuery({
    queryKey: keys.missionEvents({ count_of: missionId }),
    queryFn: async ({ signal }) => (await call(api.GET("/api/v1/mission-events", { params: { query: { mission_id: missionId, limit: 1, count: true } }, signal }))).total ?? null,
  });
}

/** The findings with a time of the latest runs, by time. `isCut`: there are more than were read. */
export function useTimedFindings(missionId: () => string, enabled: () => boolean) {
  return useQuery({
    queryKey: computed(() => keys.runs({ findings_of: missionId() })),
    queryFn: async ({ signal }): Promise<{ readonly findings: readonly FindingWithTime[]; readonly isCut: boolean }> => {
      const findings: FindingWithTime[] = [];
      let cursor: string | null | undefined;
      for (let read = 0; cursor !== null && read < MAX_FINDINGS; read += PAGE) {
        const query = { mission_id: missionId(), latest: true, limit: PAGE, ...(cursor && { cursor }) };
        const page = await call(api.GET("/api/v1/findings", { params: { query }, signal }));
        findings.push(...page.items.filter((row): row is FindingWithTime => typeof row.finding.time_ns === "number"));
        cursor = page.next ?? null;
      }
      return { findings: findings.toSorted((a, b) => a.finding.time_ns - b.finding.time_ns), isCut: cursor !== null };
    },
    enabled,
  });
}

/** The first events of some names in some missions, by mission, each by start. */
export function useEventsOfMissions(names: () => readonly string[], missionIds: () => readonly string[]) {
  const query = computed(() => ({ name: [...names()], mission_ids: [...new Set(missionIds())] }));
  return useQuery({
    queryKey: computed(() => keys.missionEvents(query.value)),
    queryFn: async ({ signal }): Promise<ReadonlyMap<string, readonly MissionEvent[]>> => {
      const { name, mission_ids: ids } = query.value;
      const ofMissions = new Map<string, MissionEvent[]>();
      for (let at = 0; at < ids.length; at += MAX_MISSIONS) {
        const some = { name, mission_ids: ids.slice(at, at + MAX_MISSIONS), limit: PAGE };
        const page = await call(api.GET("/api/v1/mission-events", { params: { query: some }, signal }));
        for (const event of page.items) ofMissions.set(event.mission.id, [...(ofMissions.get(event.mission.id) ?? []), event]);
      }
      return ofMissions;
    },
    enabled: () => query.value.name.length > 0 && query.value.mission_ids.length > 0,
    placeholderData: keepPreviousData,
  });
}

/** Mutations of the events of a mission. */
export function useEventChanges(missionId: () => string) {
  const queries = useQueryClient();
  const onSuccess = () => queries.invalidateQueries({ queryKey: ["mission-events"] });
  const add = useMutation({
    mutationFn: (body: NewEvent) => call(api.POST("/api/v1/missions/{mission_id}/events", { params: { path: { mission_id: missionId() } }, body })),
    onSuccess,
    meta: { showsItself: true },
  });
  const update = useMutation({
    mutationFn: ({ id, etag, ...body }: EventChange & EtagCarrier & { readonly id: string }) =>
      call(api.PATCH("/api/v1/mission-events/{event_id}", { params: { path: { event_id: id }, header: ifMatch(etag) }, body })),
    onSuccess: (event, { etag }) => {
      noteNewEtag(etag, event.etag);
      return onSuccess();
    },
    meta: { showsItself: true },
  });
  const remove = useMutation({
    mutationFn: (id: string) => call(api.DELETE("/api/v1/mission-events/{event_id}", { params: { path: { event_id: id } } })),
    onSuccess,
    meta: { showsItself: true },
  });
  return { add, update, remove };
}
