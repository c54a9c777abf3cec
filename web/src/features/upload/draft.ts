// The selection for the next upload. It is kept outside of components, so that it survives navigation.
import { shallowReactive, watch } from "vue";
import { chosen, entriesOf, walk } from "./engine/reading";
import type { Found, LeftOut, UploadPlan } from "./engine/types";
import { planUpload } from "./engine/plan";
import { useQuery } from "@tanstack/vue-query";
import { useRoute } from "vue-router";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";

export type Layout = "tree" | "contents";

export interface Draft {
  plan: UploadPlan | null;
  layout: Layout;
  /** The names of the selected folders or files. */
  roots: readonly string[];
  isLooking: boolean;
  /** How many files were found so far. */
  seen: number;
  isEmpty: boolean;
}

const BEGINNING: Draft = { plan: null, layout: "tree", roots: [], isLooking: false, seen: 0, isEmpty: false };
const clock = {
  now: () => Date.now(),
  wait: (milliseconds: number) => new Promise<void>((resolve) => setTimeout(resolve, milliseconds)),
};

interface Chosen {
  readonly droppedFiles: readonly Found[];
  readonly unreadable: readonly string[];
}

export interface OpenDraft extends Draft {
  /** Take files that were chosen. */
  take(files: Iterable<File>): Promise<void>;
  /** Add dropped items. Must be called in the handler of the drop event. */
  drop(transfer: DataTransfer): Promise<void>;
  /** Plan again with other paths. */
  arrange(layout: Layout): Promise<void>;
  clear(): void;
}

/** Return a draft that begins with a layout; each place where one chooses files has its own. */
export function openDraft(layout: Layout = BEGINNING.layout): OpenDraft {
  let all: Chosen = { droppedFiles: [], unreadable: [] };
  /** Counts requests, to discard outdated results. */
  let turn = 0;

  async function plan(): Promise<void> {
    const mine = (turn += 1);
    const areInFolders = all.droppedFiles.every(({ path }) => path.includes("/"));
    const planned = await planUpload(all.droppedFiles, { layout: areInFolders ? made.layout : "tree", watch: clock });
    if (mine !== turn) return;
    const unreadable = all.unreadable.map((path): LeftOut => ({ path, reason: "unreadable", detail: "" }));
    const leftOut = [...planned.leftOut, ...unreadable];
    const isEmpty = planned.files.length === 0 && leftOut.length === 0;
    Object.assign(made, { plan: isEmpty ? null : { ...planned, leftOut }, isLooking: false, isEmpty });
  }

  async function take(droppedFiles: readonly Found[], unreadable: readonly string[] = []): Promise<void> {
    all = { droppedFiles, unreadable };
    const roots = [...new Set(droppedFiles.map(({ path }) => path.split("/", 1)[0] ?? path))];
    Object.assign(made, { isLooking: true, seen: droppedFiles.length, roots });
    await plan();
  }

  const made: OpenDraft = shallowReactive({
    ...BEGINNING,
    layout,
    take: (files: Iterable<File>) => take(chosen(files)),
    drop: async (transfer: DataTransfer) => {
      const entries = entriesOf(transfer);
      const mine = (turn += 1);
      Object.assign(made, { isLooking: true, seen: 0 });
      const { droppedFiles, unreadable } = await walk(entries, (count) => (made.seen = count));
      if (mine === turn) await take(droppedFiles, unreadable);
    },
    arrange: async (expected: Layout) => {
      Object.assign(made, { layout: expected, isLooking: true });
      await plan();
    },
    clear: () => {
      turn += 1;
      Object.assign(made, BEGINNING, { layout });
    },
  });
  return made;
}

export const draft = openDraft();

const LISTED = 200;

/** Returns how files of these paths are laid out to go on with those wanted: without their folder where only so one is. */
export function layoutFor(paths: readonly string[], expected: ReadonlySet<string>): Layout {
  const isWanted = (path: string) => expected.has(path);
  const within = paths.map((path) => path.slice(path.indexOf("/") + 1));
  return !paths.some(isWanted) && within.some(isWanted) ? "contents" : "tree";
}

/** Lays out what is chosen as what is unfinished in the mission that the address names. What one then chooses oneself, stays. */
export function useFittingLayout(draft: OpenDraft): void {
  const queried = useRoute().query.mission;
  const missionId = typeof queried === "string" ? queried : "";
  const { data: uploads } = useQuery({
    queryKey: keys.uploads(missionId),
    queryFn: ({ signal }) =>
      call(api.GET("/api/v1/missions/{mission_id}/uploads", { params: { path: { mission_id: missionId }, query: { limit: LISTED } }, signal })),
    enabled: missionId !== "",
  });
  let seen: readonly string[] | null = null;
  watch([() => draft.plan, uploads], ([plan, listed]) => {
    if (plan === null || listed === undefined || seen === draft.roots) return;
    seen = draft.roots;
    const layout = layoutFor(plan.files.map(({ path }) => path), new Set(listed.items.map(({ path }) => path)));
    if (draft.layout === "tree" && layout === "contents") void draft.arrange(layout);
  }, { immediate: true });
}
