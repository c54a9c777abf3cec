// Queries and mutations of a mission, and its warnings.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import type { File, Mission, Recording } from "@/api/types";
import type { Warning } from "@/components/warnings";
import { warningsOfFile } from "@/features/file/queries";
import { texts } from "@/texts/mission";

type Schemas = components["schemas"];
export type MissionChange = Schemas["MissionUpdate"];
export type TimelineFile = Schemas["TimelineFile"];
/** `recordings` are pairs of first and last place. */
export type MissionTopic = Omit<Schemas["MissionTopic"], "recordings"> & { readonly recordings: readonly (readonly number[])[] };
export type TimeAxisOf = Schemas["TimeAxis"];

export interface Timeline {
  readonly startNs: number | null;
  readonly endNs: number | null;
  readonly files: readonly TimelineFile[];
}

export interface Topics {
  readonly axis: TimeAxisOf | null;
  readonly recordings: readonly Schemas["RecordingRef"][];
  readonly items: readonly MissionTopic[];
  readonly isCurrent: boolean;
}

const PAGE = 10_000;
const RECORDINGS_PAGE = 500;
const TOPICS_PAGE = 1000;
/** Topics with a drawn density. The server stores at most 20,000. */
const BINS = 192;
const FAST_POLL_MS = 2_000;
const MAX_FILES_WITH_WARNINGS = 500;

export const missionKeys = {
  timeline: (id: string) => [...keys.mission(id), "timeline"],
  topics: (id: string) => [...keys.mission(id), "topics"],
  withWarnings: (id: string) => [...keys.mission(id), "with-warnings"],
} as const;

/** Loads all pages. */
async function all<Part extends { readonly next?: string | null | undefined }>(fetchPage: (cursor: string | undefined) => Promise<Part>): Promise<Part[]> {
  const parts: Part[] = [];
  for (let cursor: string | null | undefined; cursor !== null; ) {
    const part = await fetchPage(cursor);
    parts.push(part);
    cursor = part.next ?? null;
  }
  return parts;
}

export function useMission(missionId: string) {
  const path = { mission_id: missionId };
  return useQuery({
    queryKey: keys.mission(missionId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/missions/{mission_id}", { params: { path }, signal })),
  });
}

/** All files of the mission, and when each was recorded. */
export function useTimeline(missionId: string) {
  const path = { mission_id: missionId };
  return useQuery({
    queryKey: missionKeys.timeline(missionId),
    queryFn: async ({ signal }): Promise<Timeline> => {
      const parts = await all((cursor) =>
        call(api.GET("/api/v1/missions/{mission_id}/timeline", { params: { path, query: { limit: PAGE, ...(cursor && { cursor }) } }, signal })),
      );
      const [first] = parts;
      return { startNs: first?.start_ns ?? null, endNs: first?.end_ns ?? null, files: parts.flatMap((part) => part.items) };
    },
    structuralSharing: false, // comparing ten thousand files is slower than rendering the visible ones
  });
}

export function useRecordings(missionId: string) {
  const path = { mission_id: missionId };
  return useQuery({
    queryKey: keys.recordings(missionId),
    queryFn: async ({ signal }): Promise<readonly Recording[]> => {
      const parts = await all((cursor) =>
        call(api.GET("/api/v1/missions/{mission_id}/recordings", { params: { path, query: { limit: RECORDINGS_PAGE, ...(cursor && { cursor }) } }, signal })),
      );
      return parts.flatMap((part) => part.items);
    },
  });
}

/** The topics of all recordings; refetched until they are current. */
export function useMissionTopics(missionId: string, isEnabled: () => boolean) {
  const path = { mission_id: missionId };
  return useQuery({
    queryKey: missionKeys.topics(missionId),
    queryFn: async ({ signal }): Promise<Topics> => {
      const query = { limit: TOPICS_PAGE, bins: BINS };
      const parts = await all((cursor) =>
        call(api.GET("/api/v1/missions/{mission_id}/topics", { params: { path, query: { ...query, ...(cursor && { cursor }) } }, signal })),
      );
      const [first] = parts;
      return {
        axis: first?.axis ?? null,
        recordings: first?.recordings ?? [],
        items: parts.flatMap((part) => part.items),
        isCurrent: parts.every((part) => part.is_current),
      };
    },
    enabled: isEnabled,
    structuralSharing: false,
    placeholderData: keepPreviousData,
    refetchInterval: (running) => (running.state.data?.isCurrent === false ? FAST_POLL_MS : false),
  });
}

/** The first files with warnings, by path. `isCut`: there are more. */
export function useFilesWithWarnings(missionId: string) {
  return useQuery({
    queryKey: missionKeys.withWarnings(missionId),
    queryFn: async ({ signal }): Promise<{ readonly files: readonly File[]; readonly isCut: boolean }> => {
      const common = { mission_id: missionId, sort: "path", limit: MAX_FILES_WITH_WARNINGS } as const;
      const [inside, bytes, noted] = await Promise.all([
        call(api.GET("/api/v1/files", { params: { query: { ...common, content: ["recovered", "broken", "error"] } }, signal })),
        call(api.GET("/api/v1/files", { params: { query: { ...common, state: ["lost", "corrupt"] } }, signal })),
        call(api.GET("/api/v1/files", { params: { query: { ...common, problem: ["*"] } }, signal })),
      ]);
      const known = new Map([...bytes.items, ...inside.items, ...noted.items].map((file) => [file.id, file]));
      return { files: [...known.values()], isCut: [inside, bytes, noted].some(({ next }) => next !== null) };
    },
  });
}

/** Mutations. After a deletion, call `old` only after leaving the page: it would refetch the deleted item. */
export function useMissionChanges(missionId: string) {
  const queries = useQueryClient();
  const path = { mission_id: missionId };

  function old(): void {
    void queries.invalidateQueries({ queryKey: ["missions"] });
    void queries.invalidateQueries({ queryKey: ["projects"] });
    void queries.invalidateQueries({ queryKey: ["files"] });
    void queries.invalidateQueries({ queryKey: ["trash"] });
  }

  const update = useMutation({
    mutationFn: ({ etag, ...body }: MissionChange & EtagCarrier) =>
      call(api.PATCH("/api/v1/missions/{mission_id}", { params: { path, header: ifMatch(etag) }, body })),
    onSuccess: (mission, { etag }) => {
      noteNewEtag(etag, mission.etag);
      queries.setQueryData(keys.mission(missionId), mission);
      old();
    },
    meta: { showsItself: true },
  });
  const remove = useMutation({
    mutationFn: () => call(api.DELETE("/api/v1/missions/{mission_id}", { params: { path } })),
    meta: { showsItself: true },
  });
  const restore = useMutation({
    mutationFn: () => call(api.POST("/api/v1/trash/{resource_type}/{resource_id}/restore", { params: { path: { resource_type: "mission", resource_id: missionId } } })),
    onSuccess: old,
  });
  return { update, remove, restore, old };
}

function ofRecording(recording: Recording): Warning[] {
  const place = { source: recording.name, fileId: null };
  return [
    ...recording.missing.map((path) => ({ code: "member-missing", message: texts.missingFile(path), where: "", ...place })),
    ...recording.unlisted.map((path) => ({ code: "member-unlisted", message: texts.unlistedFile(path), where: "", ...place })),
    ...recording.problems.map(({ code, message, where }) => ({ code, message, where, ...place })),
  ];
}

/** Returns all warnings of a mission. */
export function warningsOfMission(mission: Mission | undefined, recordings: readonly Recording[], files: readonly File[]): readonly Warning[] {
  const ofMetadata = (mission?.metadata_problems ?? []).map(({ field, message }) => (
    { code: "metadata", message: texts.metadataProblem(field, message), where: "", source: "", fileId: null }
  ));
  return [...ofMetadata, ...recordings.flatMap(ofRecording), ...files.flatMap(warningsOfFile)];
}
