// What the page of a file asks the server, and what it has it do.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import type { Ref } from "vue";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import type { File, Topic } from "@/api/types";
import { showToast } from "@/components/toasts";
import { texts } from "@/texts/file";

type Change = components["schemas"]["FileUpdate"];

const PAGE = 500;
/** Topics of one file that are shown; a recording with more of them is a fault. */
const MOST_TOPICS = 5_000;
const SOON_MS = 2_000;
const ALL_RIGHTS = ["READ", "CREATE", "WRITE", "DELETE"] as const;

/** Whether the server will know more of the file shortly: it is being read, or verified. */
function isComing(file: File | undefined, isVerifying: boolean): boolean {
  return file !== undefined && (isVerifying || (file.content === "pending" && file.summarised_at === null));
}

export function useFile(fileId: string, isVerifying: () => boolean) {
  return useQuery({
    queryKey: keys.file(fileId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/files/{file_id}", { params: { path: { file_id: fileId } }, signal })),
    refetchInterval: (query) => (isComing(query.state.data, isVerifying()) ? SOON_MS : false),
  });
}

/** All topics of the file, by name; `version` changes when the server has read it anew. */
export function useFileTopics(fileId: string, version: () => string | null | undefined) {
  return useQuery({
    queryKey: [...keys.fileTopics(fileId), version],
    queryFn: async ({ signal }) => {
      const topics: Topic[] = [];
      for (let cursor: string | null | undefined; cursor !== null && topics.length < MOST_TOPICS; ) {
        const query = cursor === undefined ? { limit: PAGE } : { limit: PAGE, cursor };
        const params = { path: { file_id: fileId }, query };
        const page = await call(api.GET("/api/v1/files/{file_id}/topics", { params, signal }));
        topics.push(...page.items);
        cursor = page.next ?? null;
      }
      return topics;
    },
  });
}

export function useMissionOf(missionId: () => string | undefined) {
  return useQuery({
    queryKey: ["missions", "one", missionId],
    queryFn: ({ signal }) => call(api.GET("/api/v1/missions/{mission_id}", { params: { path: { mission_id: missionId() ?? "" } }, signal })),
    enabled: () => missionId() !== undefined,
  });
}

/** Whether a right is at least as much as another. */
export function reaches(right: (typeof ALL_RIGHTS)[number] | undefined, needed: (typeof ALL_RIGHTS)[number]): boolean {
  return right !== undefined && ALL_RIGHTS.indexOf(right) >= ALL_RIGHTS.indexOf(needed);
}

/** What one can have done. Who removes it calls `old` once its page is left: it would ask for what is gone. */
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
    mutationFn: () => call(api.POST("/api/v1/trash/{noun}/{noun_id}/restore", { params: { path: { noun: "file", noun_id: fileId } } })),
    onSuccess: old,
  });
  const remove = useMutation({
    mutationFn: () => call(api.DELETE("/api/v1/files/{file_id}", { params: { path } })),
    meta: { showsItself: true },
  });
  return { update, verify, remove, restore, old };
}

/** What runs made of a file, asked for when somebody is about to delete it. */
export function useMadeOf(fileId: string, isEnabled: Readonly<Ref<boolean>>) {
  return useQuery({
    queryKey: [...keys.file(fileId), "deletion"],
    queryFn: () => call(api.DELETE("/api/v1/files/{file_id}", { params: { path: { file_id: fileId }, query: { dry_run: true } } })),
    select: ({ made_from_it: paths }) => paths,
    enabled: isEnabled,
  });
}
