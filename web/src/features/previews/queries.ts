// Queries of previews: those of a mission, and small pictures of missions and files in lists.
import { useQuery } from "@tanstack/vue-query";
import { computed, type Ref } from "vue";
import { jpegOf, thumbnailOf } from "./thumbnails";
import { batched } from "@/api/batched";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import { useMe } from "@/api/session";
import type { PreviewArtifact } from "@/features/runs/queries";

type Schemas = components["schemas"];
export type MissionPreview = Schemas["MissionPreview"];
export type MissionPicture = Schemas["MissionPicture"];
export type MissionThumbnail = Schemas["MissionThumbnail"];

/** The most missions or files that the server takes at once. */
const MOST = 200;
/** A list that is opened again asks for its pictures again only after this time. Each request is recorded in the audit log. */
const FRESH_MS = 300_000;

/** The previews of a mission; visitors without an account see none. */
export function useMissionPreviews(missionId: string) {
  const { me } = useMe();
  const path = { mission_id: missionId };
  return useQuery({
    queryKey: keys.missionPreviews(missionId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/missions/{mission_id}/previews", { params: { path }, signal })),
    enabled: () => me.value !== null,
  });
}

export function artifactOf({ artifact_id: id, run_id, path, size_bytes }: MissionPreview): PreviewArtifact {
  return { id, run_id, path, size_bytes };
}

export function nameOf({ title, path }: Pick<MissionPreview, "title" | "path">): string {
  return title || path;
}

const pictureOf = batched(async (missionIds) => {
  const { items, thumbnails } = await call(api.POST("/api/v1/missions/pictures", { body: { mission_ids: [...missionIds] } }));
  return new Map<string, MissionPicture | MissionThumbnail>([...thumbnails, ...items].map((item) => [item.mission_id, item]));
}, MOST);

function idOf(picture: MissionPicture | MissionThumbnail): string {
  return "jpeg" in picture ? picture.file_id : picture.artifact_id;
}

/** The first picture of a mission, or one that a camera recorded; and a small copy of it. */
export function useThumbnail(missionId: () => string, isEnabled: () => boolean) {
  const { me } = useMe();
  const { data: picture } = useQuery({
    queryKey: computed(() => ["pictures", missionId()]),
    queryFn: async () => (await pictureOf(missionId())) ?? null,
    enabled: () => me.value !== null && isEnabled(),
    staleTime: FRESH_MS,
  });
  const { data: bytes } = useQuery({
    queryKey: computed(() => ["thumbnails", picture.value === null || picture.value === undefined ? "" : idOf(picture.value)]),
    queryFn: ({ signal }) => thumbnailOf(picture.value as MissionPicture | MissionThumbnail, pictureOf, signal),
    enabled: () => isEnabled() && Boolean(picture.value),
    staleTime: "static", // artifacts never change
  });
  return { picture, bytes };
}

const jpegOfFile = batched(async (fileIds) => {
  const { items } = await call(api.POST("/api/v1/files/thumbnails", { body: { file_ids: [...fileIds] } }));
  return new Map(items.map(({ file_id: id, jpeg }) => [id, jpeg]));
}, MOST);

/** A picture that a camera recorded in a file; null where there is none. */
export function useFileThumbnail(fileId: () => string, isEnabled: () => boolean): Readonly<Ref<Blob | null | undefined>> {
  const { data } = useQuery({
    queryKey: computed(() => ["file-thumbnails", fileId()]),
    queryFn: async () => {
      const jpeg = await jpegOfFile(fileId());
      return jpeg === undefined ? null : jpegOf(jpeg);
    },
    enabled: isEnabled,
    staleTime: FRESH_MS,
  });
  return data;
}
