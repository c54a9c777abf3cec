// Queries and mutations of a file, its warnings, and the coverage of its topics.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import type { Ref } from "vue";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import type { File, Topic } from "@/api/types";
import { showToast } from "@/components/toasts";
import { texts } from "@/texts/file";
import type { Warning } from "@/components/warnings";
import { blobTexts, contentTexts } from "@/texts/states";

type Change = components["schemas"]["FileUpdate"];

const PAGE = 500;
/** As many topics as the server reads of one file. */
const MAX_TOPICS = 20_000;
const FAST_POLL_MS = 2_000;
const ALL_RIGHTS = ["READ", "CREATE", "WRITE", "DELETE"] as const;

/** Whether the file is about to change, because it is being indexed or verified. */
function isComing(file: File | undefined, isVerifying: boolean): boolean {
  return file !== undefined && (isVerifying || (file.content === "pending" && file.summarised_at === null));
}

export function useFile(fileId: string, isVerifying: () => boolean) {
  return useQuery({
    queryKey: keys.file(fileId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/files/{file_id}", { params: { path: { file_id: fileId } }, signal })),
    refetchInterval: (query) => (isComing(query.state.data, isVerifying()) ? FAST_POLL_MS : false),
  });
}

/** All topics of the file, by name; `version` changes when the server has read the file again. */
export function useFileTopics(fileId: string, version: () => string | null | undefined) {
  return useQuery({
    queryKey: [...keys.fileTopics(fileId), version],
    queryFn: ({ signal }) => fetchFileTopics(fileId, signal),
  });
}

/** Returns all topics of a file, by name. */
export async function fetchFileTopics(fileId: string, signal: AbortSignal): Promise<Topic[]> {
  const topics: Topic[] = [];
  for (let cursor: string | null | undefined; cursor !== null && topics.length < MAX_TOPICS; ) {
    const query = cursor === undefined ? { limit: PAGE } : { limit: PAGE, cursor };
    const params = { path: { file_id: fileId }, query };
    const page = await call(api.GET("/api/v1/files/{file_id}/topics", { params, signal }));
    topics.push(...page.items);
    cursor = page.next ?? null;
  }
  return topics;
}

export function useMissionOf(missionId: () => string | undefined) {
  return useQuery({
    queryKey: ["missions", "one", missionId],
    queryFn: ({ signal }) => call(api.GET("/api/v1/missions/{mission_id}", { params: { path: { mission_id: missionId() ?? "" } }, signal })),
    enabled: () => missionId() !== undefined,
  });
}

/** Whether a right is at least as much as another. */
export function hasRight(right: (typeof ALL_RIGHTS)[number] | undefined, needed: (typeof ALL_RIGHTS)[number]): boolean {
  return right !== undefined && ALL_RIGHTS.indexOf(right) >= ALL_RIGHTS.indexOf(needed);
}

/** Mutations. After a deletion, call `old` only after leaving the page: it would refetch the deleted item. */
export function useFileChanges(fileId: string) {
  const queries = useQueryClient();
  const path = { file_id: fileId };

  function old(): void {
    void queries.invalidateQueries({ queryKey: ["files"] });
    void queries.invalidateQueries({ queryKey: ["missions"] });
  }

  const update = useMutation({
    mutationFn: ({ etag, ...body }: Change & EtagCarrier) =>
      call(api.PATCH("/api/v1/files/{file_id}", { params: { path, header: ifMatch(etag) }, body })),
    onSuccess: (file, { etag }) => {
      noteNewEtag(etag, file.etag);
      queries.setQueryData(keys.file(fileId), file);
      old();
    },
    meta: { showsItself: true },
  });
  const verify = useMutation({
    mutationFn: () => call(api.POST("/api/v1/files/{file_id}/verify", { params: { path } })),
    onSuccess: () => showToast({ tone: "plain", text: texts.verifying }),
  });
  const restore = useMutation({
    mutationFn: () => call(api.POST("/api/v1/trash/{resource_type}/{resource_id}/restore", { params: { path: { resource_type: "file", resource_id: fileId } } })),
    onSuccess: old,
  });
  const remove = useMutation({
    mutationFn: () => call(api.DELETE("/api/v1/files/{file_id}", { params: { path } })),
    meta: { showsItself: true },
  });
  return { update, verify, remove, restore, old };
}

/** Files that runs derived from a file; loaded before it is deleted. */
export function useMadeOf(fileId: string, isEnabled: Readonly<Ref<boolean>>) {
  return useQuery({
    queryKey: [...keys.file(fileId), "deletion"],
    queryFn: () => call(api.DELETE("/api/v1/files/{file_id}", { params: { path: { file_id: fileId }, query: { dry_run: true } } })),
    select: ({ made_from_it: paths }) => paths,
    enabled: isEnabled,
  });
}

const PARTS = 120;

/** Returns for each part of the file's span whether the topic is there: 1 or 0. */
export function coverage(topic: Topic, file: File): number[] {
  const { start_ns: start, end_ns: end } = file;
  const { first_ns: first, last_ns: last } = topic;
  if (start === null || end === null || first === null || last === null) return [];
  const part = Math.max(1, end - start) / PARTS;
  return Array.from({ length: PARTS }, (_, at) => {
    const from = start + at * part;
    const isAtEnd = at === PARTS - 1 && last >= end;
    return first < from + part && (last >= from || isAtEnd) ? 1 : 0;
  });
}

/** Returns all warnings of a file. */
export function warningsOfFile(file: File): readonly Warning[] {
  const warnings: Warning[] = [];
  const add = (code: string, message: string, where = "") => warnings.push({ code, message, where, source: file.path, fileId: file.id });
  if (file.state === "lost" || file.state === "corrupt") add(`bytes-${file.state}`, file.state_reason ?? blobTexts[file.state].why);
  if (file.content === "broken" || file.content === "error") add("unreadable", file.content_reason ?? contentTexts[file.content].why);
  if (file.content === "recovered") add("recovered", file.content_reason ?? contentTexts.recovered.why);
  if (file.lost !== null) add("data-lost", texts.lostAmount(file.lost.bytes, file.lost.chunks, file.lost.messages));
  for (const { code, message, where } of file.problems) add(code, message, where);
  return warnings;
}

/** Returns the URL of a viewer that opens the recording at another URL. */
export function viewerAddress(template: string, recording: string): string {
  return template.replaceAll("{url}", encodeURIComponent(recording));
}
