// What the viewer knows before it reads a byte: the recordings of a mission or a file, and their topics.
import { useQuery } from "@tanstack/vue-query";
import { computed, ref, shallowRef, watch, type ComputedRef } from "vue";
import type { RouteLocationRaw } from "vue-router";
import { useFile, useFileTopics } from "@/features/file/queries";
import { useMission, useMissionTopics, useRecordings, type MissionTopic, type Topics } from "@/features/mission/queries";
import type { Panel } from "./layout";
import type { NamedPosition } from "./locations";
import type { SourceFile, SourceRecording } from "./sources";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { File, Recording, Topic } from "@/api/types";
import type { Span } from "@/recordings/formats/recording";
import { READABLE_FORMATS } from "@/recordings/protocol";

/** A topic that a panel can show. */
export interface ViewerTopic {
  /** `SourceRecording.key`. */
  readonly recording: string;
  readonly name: string;
  readonly messageType: string | null;
  readonly count: number | null;
  readonly firstNs: number | null;
  /** How many messages are in each part of the time, if known. */
  readonly density: readonly number[];
}

export interface ViewerData {
  readonly recordings: readonly SourceRecording[];
  readonly topics: readonly ViewerTopic[];
}

/** The data of a viewer as they arrive, and what failed. */
export interface ViewerSource {
  readonly data: ComputedRef<ViewerData | null>;
  readonly error: ComputedRef<Error | null>;
  readonly again: () => unknown;
  readonly isComplete: () => boolean;
}

/** What the recordings of a viewer belong to. */
export interface ViewerPlace {
  readonly missionId: string;
  readonly projectId: string;
  readonly title: string;
  /** Where the page is in the app; empty outside of it. */
  readonly crumbs: readonly { readonly label: string; readonly to: RouteLocationRaw }[];
  /** Places in the metadata of the mission. */
  readonly locations: readonly NamedPosition[];
}

const PAGE = 500;
const MAX_FILES = 2_000;
/** The API rounds times to doubles, which differ by up to 128 ns. */
const ROUNDING_NS = 256n;
const KEY_LENGTH = 8;

/** Returns the files of a mission that the viewer reads. */
export function useReadableFiles(missionId: string) {
  return useQuery({
    queryKey: [...keys.mission(missionId), "readable-files"],
    queryFn: async ({ signal }): Promise<readonly File[]> => {
      const files: File[] = [];
      for (let cursor: string | null | undefined; cursor !== null && files.length < MAX_FILES; ) {
        const filter = { mission_id: missionId, format: [...READABLE_FORMATS], content: ["indexed", "recovered"] as ("indexed" | "recovered")[], limit: PAGE };
        const query = cursor === undefined ? filter : { ...filter, cursor };
        const page = await call(api.GET("/api/v1/files", { params: { query }, signal }));
        files.push(...page.items);
        cursor = page.next ?? null;
      }
      return files;
    },
  });
}

/** Returns the viewer's data of a mission, its title, and what failed. */
export function useMissionData(missionId: string) {
  const mission = useMission(missionId);
  const files = useReadableFiles(missionId);
  const recordings = useRecordings(missionId);
  const topics = useMissionTopics(missionId, () => true);
  const data = computed<ViewerData | null>(() => {
    if (files.data.value === undefined || recordings.data.value === undefined || topics.data.value === undefined) return null;
    const sources = sourcesOf(files.data.value, recordings.data.value);
    return { recordings: [...sources.values()], topics: topicsOf(topics.data.value, sources) };
  });
  const error = computed(() => mission.error.value ?? files.error.value ?? recordings.error.value ?? topics.error.value);
  const again = () => Promise.all([mission.refetch(), files.refetch(), recordings.refetch(), topics.refetch()]);
  /** While the server reads files, more topics follow. */
  const isComplete = () => topics.data.value?.isCurrent === true;
  return { data, error, again, isComplete, place: computed(() => mission.data.value) };
}

/** Returns the viewer's data of one file, and what failed. */
export function useFileData(fileId: string) {
  const file = useFile(fileId, () => false);
  const topics = useFileTopics(fileId, () => file.data.value?.summarised_at);
  const data = computed<ViewerData | null>(() => {
    if (file.data.value === undefined || topics.data.value === undefined) return null;
    const source = sourceOf(file.data.value);
    const key = fileId.slice(0, KEY_LENGTH);
    const recordings = source === null ? [] : [{ key, name: file.data.value.path, files: [source] }];
    return { recordings, topics: recordings.length === 0 ? [] : topics.data.value.map((topic) => topicOfFile(topic, key)) };
  });
  const error = computed(() => file.error.value ?? topics.error.value);
  const again = () => Promise.all([file.refetch(), topics.refetch()]);
  return { data, error, again, isComplete: () => true, place: computed(() => file.data.value) };
}

/** Returns the first data that is complete, or until then the latest: later data would end playing, and an open form. */
export function useFirstData(data: ComputedRef<ViewerData | null>, isComplete: () => boolean) {
  const first = shallowRef<ViewerData | null>(null);
  /** How often later data replaced it. */
  const reloads = ref(0);
  let isSettled = false;
  const isChanged = computed(() => data.value !== null && first.value !== null && !areEqual(data.value, first.value));

  function reload(): void {
    if (data.value === null) return;
    first.value = data.value;
    reloads.value += 1;
  }

  watch(data, (now) => {
    if (now === null || (isSettled && first.value?.recordings.length !== 0)) return;
    if (first.value === null || isChanged.value) reload();
    isSettled = now.topics.length > 0 && isComplete();
  }, { immediate: true });
  return { first, isChanged, reloads, reload };
}

function areEqual(one: ViewerData, other: ViewerData): boolean {
  const textOf = ({ recordings, topics }: ViewerData) =>
    JSON.stringify([recordings.map(({ key, files }) => [key, files.map(({ id }) => id)]), topics.map(({ recording, name, count }) => [recording, name, count])]);
  return one === other || textOf(one) === textOf(other);
}

/** Returns a topic of a file as one of the recording with this key. */
export function topicOfFile({ name, message_type, count, first_ns }: Topic, recording: string): ViewerTopic {
  return { recording, name, messageType: message_type, count, firstNs: first_ns, density: [] };
}

function sourceOf(file: File): SourceFile | null {
  const format = READABLE_FORMATS.find((readable) => readable === file.format);
  const { id, path, size_bytes, start_ns, end_ns, content, state } = file;
  const isReadable = (content === "indexed" || content === "recovered") && (state === "stored" || state === "verified");
  if (format === undefined || !isReadable || start_ns === null || end_ns === null) return null;
  return { id, path, size_bytes, format, span: { fromNs: BigInt(start_ns) - ROUNDING_NS, toNs: BigInt(end_ns) + ROUNDING_NS } };
}

/** Returns the recordings by their ids. */
export function sourcesOf(files: readonly File[], recordings: readonly Recording[]): ReadonlyMap<string, SourceRecording> {
  const names = new Map(recordings.map(({ id, name }) => [id, name]));
  const filesById = new Map<string, SourceFile[]>();
  for (const file of files) {
    const source = sourceOf(file);
    const id = file.recording_id ?? file.id;
    if (source !== null) filesById.set(id, [...(filesById.get(id) ?? []), source]);
  }
  const keysOf = new Map<string, number>();
  for (const id of filesById.keys()) keysOf.set(id.slice(0, KEY_LENGTH), (keysOf.get(id.slice(0, KEY_LENGTH)) ?? 0) + 1);
  return new Map(
    [...filesById].map(([id, members]) => {
      const short = id.slice(0, KEY_LENGTH);
      const inOrder = members.toSorted((a, b) => (a.span.fromNs < b.span.fromNs ? -1 : 1));
      return [id, { key: keysOf.get(short) === 1 ? short : id, name: names.get(id) ?? members[0]?.path ?? id, files: inOrder }];
    }),
  );
}

/** Returns each topic of each recording that can be read. */
function topicsOf({ items, recordings }: Topics, sources: ReadonlyMap<string, SourceRecording>): ViewerTopic[] {
  return items.flatMap((topic) =>
    placesOf(topic).flatMap((place): ViewerTopic[] => {
      const source = sources.get(recordings[place]?.id ?? "");
      if (source === undefined) return [];
      const { name, message_type, count, first_ns, counts } = topic;
      return [{ recording: source.key, name, messageType: message_type, count, firstNs: first_ns, density: counts ?? [] }];
    }),
  );
}

function placesOf({ recordings }: MissionTopic): number[] {
  return recordings.flatMap(([first = 0, last = first]) => Array.from({ length: last - first + 1 }, (_, at) => first + at));
}

/** Returns the number of messages in equal parts of the time, of all topics. */
export function densityOf(topics: readonly ViewerTopic[]): number[] {
  const byName = new Map(topics.filter(({ density }) => density.length > 0).map(({ name, density }) => [name, density])); // a topic of several recordings once
  const sums: number[] = [];
  for (const density of byName.values()) density.forEach((count, place) => (sums[place] = (sums[place] ?? 0) + count));
  return sums;
}

/** How far from the beginning the viewer starts at most, so that its panels show something. */
const START_WITHIN_NS = 10e9;

/** Returns the first time at which each panel has a message, if that is near the beginning. */
export function startTime(topics: readonly ViewerTopic[], panels: readonly Panel[], { fromNs }: Span): bigint {
  const shown = new Set(panels.flatMap(({ series }) => series.map(({ recording, topic }) => `${recording} ${topic}`)));
  const firsts = topics.filter(({ recording, name }) => shown.has(`${recording} ${name}`)).flatMap(({ firstNs }) => firstNs ?? []);
  const near = firsts.filter((firstNs) => firstNs - Number(fromNs) < START_WITHIN_NS);
  return near.length === 0 ? fromNs : BigInt(Math.max(...near)) + ROUNDING_NS;
}
