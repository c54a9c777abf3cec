// The paths that a folder chosen anew has in a mission: those under which another machine began to upload it.
import { useQuery } from "@tanstack/vue-query";
import { watch } from "vue";
import { useRoute } from "vue-router";
import type { Layout, OpenDraft } from "./draft";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";

const LISTED = 200;

/** Returns how files of these paths are laid out to go on with those wanted: without their folder where only so one is. */
export function layoutFor(paths: readonly string[], wanted: ReadonlySet<string>): Layout {
  const isWanted = (path: string) => wanted.has(path);
  const within = paths.map((path) => path.slice(path.indexOf("/") + 1));
  return !paths.some(isWanted) && within.some(isWanted) ? "contents" : "tree";
}

/** Lays out what is chosen as what is unfinished in the mission that the address names. What one then chooses oneself, stays. */
export function useFittingLayout(draft: OpenDraft): void {
  const asked = useRoute().query.mission;
  const missionId = typeof asked === "string" ? asked : "";
  const { data: uploads } = useQuery({
    queryKey: keys.uploads(missionId),
    queryFn: ({ signal }) =>
      call(api.GET("/api/v1/missions/{mission_id}/uploads", { params: { path: { mission_id: missionId }, query: { limit: LISTED } }, signal })),
    enabled: missionId !== "",
  });
  let seen: readonly string[] | null = null;
  watch([() => draft.plan, uploads], ([plan, told]) => {
    if (plan === null || told === undefined || seen === draft.roots) return;
    seen = draft.roots;
    const layout = layoutFor(plan.files.map(({ path }) => path), new Set(told.items.map(({ path }) => path)));
    if (draft.layout === "tree" && layout === "contents") void draft.arrange(layout);
  }, { immediate: true });
}
