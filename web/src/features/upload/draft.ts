// What was chosen and is not begun yet; kept outside of any view, so that a look at another page loses nothing.
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
  /** What was chosen: names of folders, or of files. */
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
  readonly found: readonly Found[];
  readonly unreadable: readonly string[];
}

export interface OpenDraft extends Draft {
  /** Take files that were chosen. */
  take(files: Iterable<File>): Promise<void>;
  /** Take what was dropped; called while the drop is being handled. */
  drop(transfer: DataTransfer): Promise<void>;
  /** Plan anew with other paths. */
  arrange(layout: Layout): Promise<void>;
  clear(): void;
}

/** Return a draft that begins with a layout; each place where one chooses files has its own. */
export function openDraft(layout: Layout = BEGINNING.layout): OpenDraft {
  let all: Chosen = { found: [], unreadable: [] };
  /** Counts what was asked for: an answer to what is no longer wanted comes too late, and is dropped. */
  let turn = 0;

  async function plan(): Promise<void> {
    const mine = (turn += 1);
    const areInFolders = all.found.every(({ path }) => path.includes("/"));
    const planned = await planUpload(all.found, { layout: areInFolders ? made.layout : "tree", watch: clock });
    if (mine !== turn) return;
    const unreadable = all.unreadable.map((path): LeftOut => ({ path, reason: "unreadable", detail: "" }));
    const leftOut = [...planned.leftOut, ...unreadable];
    const isEmpty = planned.files.length === 0 && leftOut.length === 0;
    Object.assign(made, { plan: isEmpty ? null : { ...planned, leftOut }, isLooking: false, isEmpty });
  }

  async function take(found: readonly Found[], unreadable: readonly string[] = []): Promise<void> {
    all = { found, unreadable };
    const roots = [...new Set(found.map(({ path }) => path.split("/", 1)[0] ?? path))];
    Object.assign(made, { isLooking: true, seen: found.length, roots });
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
      const { found, unreadable } = await walk(entries, (count) => (made.seen = count));
      if (mine === turn) await take(found, unreadable);
    },
    arrange: async (wanted: Layout) => {
      Object.assign(made, { layout: wanted, isLooking: true });
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
