// What a share link shows, and the data of its viewer.
import { useInfiniteQuery, useQuery } from "@tanstack/vue-query";
import { computed, watch } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import type { File, Topic } from "@/api/types";
import { fetchFileTopics } from "@/features/file/queries";
import { useMissionTopics } from "@/features/mission/queries";
import { topicOfFile, useMissionData, useReadableFiles, type ViewerData, type ViewerSource, type ViewerTopic } from "@/features/viewer/queries";

export type Shared = components["schemas"]["SharedRead"];
type WithRecording = Pick<File, "id" | "recording_id">;

/** Files whose topics are requested at once. Further ones follow. */
const AT_ONCE = 100;

/** Returns what the link of this page shows. */
export function useShared() {
  return useQuery({ queryKey: ["share"], queryFn: ({ signal }) => call(api.GET("/api/v1/share", { signal })) });
}

/**
 * Returns the viewer's data of what a link shows. To a link to some files, the server lists no topics of recordings that
 * it shares in part: these are the topics of the shared files.
 */
export function useSharedData({ mission, is_whole_mission: isWhole }: Shared): ViewerSource {
  const source = useMissionData(mission.id);
  if (isWhole) return source;
  const files = useReadableFiles(mission.id);
  const topics = useMissionTopics(mission.id, () => true);
  const single = computed(() => (files.data.value && topics.data.value ? filesOutside(files.data.value, topics.data.value.recordings).map(({ id }) => id) : undefined));
  const ofFiles = useTopicsOfFiles(mission.id, () => single.value);
  return {
    data: computed(() => (source.data.value && ofFiles.topics.value ? withTopicsOf(source.data.value, ofFiles.topics.value) : null)),
    error: computed(() => source.error.value ?? ofFiles.error.value),
    again: () => Promise.all([source.again(), ofFiles.again()]),
    isComplete: () => source.isComplete() && ofFiles.isComplete(),
  };
}

/** Loads the topics of files of a mission, some files at a time; those that have arrived are shown meanwhile. */
export function useTopicsOfFiles(missionId: string, files: () => readonly string[] | undefined, fetchTopics = fetchFileTopics) {
  const query = useInfiniteQuery({
    queryKey: computed(() => [...keys.mission(missionId), "topics-of-files", files()]),
    queryFn: ({ pageParam: first, signal }) => Promise.all((files() ?? []).slice(first, first + AT_ONCE).map(async (id) => [id, await fetchTopics(id, signal)] as const)),
    initialPageParam: 0,
    getNextPageParam: (_last, pages) => (pages.length * AT_ONCE < (files()?.length ?? 0) ? pages.length * AT_ONCE : undefined),
    enabled: () => files() !== undefined,
  });
  const isNextDue = () => query.hasNextPage.value && !query.isFetching.value && query.error.value === null;
  watch(isNextDue, (isDue) => isDue && void query.fetchNextPage(), { immediate: true });
  return {
    topics: computed<ReadonlyMap<string, readonly Topic[]> | undefined>(() => query.data.value && new Map(query.data.value.pages.flat())),
    error: query.error,
    again: query.refetch,
    isComplete: () => query.isSuccess.value && !query.hasNextPage.value,
  };
}

/** Returns the files that belong to none of the recordings. */
export function filesOutside<One extends WithRecording>(files: readonly One[], recordings: readonly { readonly id: string }[]): One[] {
  const known = new Set(recordings.map(({ id }) => id));
  return files.filter(({ recording_id: recordingId }) => recordingId === null || !known.has(recordingId));
}

/** Returns the data with the topics of some files, each topic once in a recording. */
export function withTopicsOf({ recordings, topics }: ViewerData, ofFiles: ReadonlyMap<string, readonly Topic[]>): ViewerData {
  const added = recordings.flatMap(({ key, files }) => merged(files.flatMap(({ id }) => (ofFiles.get(id) ?? []).map((topic) => topicOfFile(topic, key)))));
  return { recordings, topics: [...topics, ...added] };
}

function merged(topics: readonly ViewerTopic[]): ViewerTopic[] {
  const byName = new Map<string, ViewerTopic>();
  for (const topic of topics) {
    const before = byName.get(topic.name);
    byName.set(topic.name, before === undefined ? topic : { ...before, count: sum(before.count, topic.count), firstNs: earlier(before.firstNs, topic.firstNs) });
  }
  return [...byName.values()];
}

function sum(one: number | null, other: number | null): number | null {
  return one === null || other === null ? null : one + other;
}

function earlier(one: number | null, other: number | null): number | null {
  return one === null || other === null ? (one ?? other) : Math.min(one, other);
}
