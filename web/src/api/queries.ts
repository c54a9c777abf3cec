// TanStack Query for the whole app: defaults, query keys, and paged lists.
import { keepPreviousData, MutationCache, QueryClient, useInfiniteQuery } from "@tanstack/vue-query";
import { Problem, toProblem } from "./problem";
import { showToast } from "@/components/toasts";
import { computed, toValue, type ComputedRef, type MaybeRefOrGetter } from "vue";
import type { Page } from "./types";

const FRESH_MS = 15_000;
const TRIES = 3;

function shouldRetry(failures: number, thrown: unknown): boolean {
  return failures < TRIES && thrown instanceof Problem && thrown.isPassing;
}

function retryDelayMs(failures: number): number {
  return Math.min(8000, 500 * 2 ** failures);
}

/** Sends a request that may arrive twice, again where the server or the network fails, as queries do. */
export async function repeated<Result>(send: () => Promise<Result>): Promise<Result> {
  for (let failures = 0; ; failures += 1) {
    try {
      return await send();
    } catch (thrown) {
      const problem = toProblem(thrown);
      if (!shouldRetry(failures, problem)) throw problem;
      await new Promise((resolve) => setTimeout(resolve, retryDelayMs(failures)));
    }
  }
}

declare module "@tanstack/vue-query" {
  interface Register {
    defaultError: Error;
    /** `showsItself`: the page shows failures itself; otherwise a toast does. */
    mutationMeta: { showsItself?: boolean };
  }
}

/** Returns the query client with the defaults of the app. */
export function createQueries(): QueryClient {
  return new QueryClient({
    defaultOptions: {
      queries: {
        staleTime: FRESH_MS,
        retry: shouldRetry,
        retryDelay: retryDelayMs,
        // Responses are replaced, never modified. Deep reactivity would make long lists slow.
        shallow: true,
      },
      mutations: { networkMode: "always" },
    },
    mutationCache: new MutationCache({
      onError: (error, _variables, _context, mutation) => {
        if (mutation.options.meta?.showsItself !== true) showToast({ tone: "bad", text: toProblem(error).message });
      },
    }),
  });
}

type Query = Readonly<Record<string, unknown>>;

export const keys = {
  me: ["me"],
  service: ["service"],
  stats: (query: Query) => ["stats", query],
  projects: (query: Query = {}) => ["projects", "list", query],
  project: (id: string) => ["projects", "one", id],
  projectGrants: (id: string) => ["access", "project", id, "grants"],
  projectAccess: (id: string) => ["access", "project", id, "who"],
  template: (projectId: string) => ["projects", "one", projectId, "template"],
  missions: (query: Query = {}) => ["missions", "list", query],
  mission: (id: string) => ["missions", "one", id],
  missionPositions: (query: Query = {}) => ["mission-positions", query],
  missionGrants: (id: string) => ["access", "mission", id, "grants"],
  missionChecks: (id: string) => ["missions", "one", id, "checks"],
  projectChecks: (id: string) => ["projects", "one", id, "checks"],
  projectActions: (id: string) => ["projects", "one", id, "actions"],
  missionPreviews: (id: string) => ["missions", "one", id, "previews"],
  missionAccess: (id: string) => ["access", "mission", id, "who"],
  missionEvents: (query: Query = {}) => ["mission-events", "list", query],
  recordings: (missionId: string) => ["missions", "one", missionId, "recordings"],
  uploads: (missionId: string) => ["missions", "one", missionId, "uploads"],
  files: (query: Query = {}) => ["files", "list", query],
  file: (id: string) => ["files", "one", id],
  fileTopics: (id: string) => ["files", "one", id, "topics"],
  viewerLayouts: (projectId: string) => ["viewer-layouts", projectId],
  topics: (query: Query = {}) => ["topics", "list", query],
  actions: (query: Query = {}) => ["actions", "list", query],
  action: (id: string) => ["actions", "one", id],
  runs: (query: Query = {}) => ["runs", "list", query],
  run: (id: string) => ["runs", "one", id],
  metricNames: (query: Query = {}) => ["metrics", "names", query],
  metricTable: (query: Query) => ["metrics", "table", query],
  lineage: (fileId: string) => ["files", "one", fileId, "lineage"],
  people: (query: Query = {}) => ["people", "list", query],
  person: (id: string) => ["people", "one", id],
  groups: (query: Query = {}) => ["groups", "list", query],
  group: (id: string) => ["groups", "one", id],
  members: (groupId: string) => ["groups", "one", groupId, "members"],
  tokens: (query: Query = {}) => ["tokens", "list", query],
  account: ["account"],
  sessions: ["sessions"],
  identities: ["identities"],
  signInMethods: ["sign-in-methods"],
  shares: (query: Query = {}) => ["shares", "list", query],
  audit: (query: Query = {}) => ["audit", "list", query],
  trash: (query: Query = {}) => ["trash", "list", query],
} as const;

export interface List<Item> {
  readonly rows: ComputedRef<readonly Item[]>;
  /** The total, if the request included a count; null until it is known. */
  readonly total: ComputedRef<number | null>;
  /** Whether the rows are results of the previous query, shown until those of the current one arrive. */
  readonly isStale: ComputedRef<boolean>;
  readonly hasMore: ComputedRef<boolean>;
  readonly isLoading: ComputedRef<boolean>;
  readonly isLoadingMore: ComputedRef<boolean>;
  readonly problem: ComputedRef<Problem | null>;
  readonly loadMore: () => void;
  readonly reload: () => void;
}

/** Loads a list page by page. `fetchPage` gets the query with the cursor of the page, which is undefined for the first one. */
export function useList<Item, Filters extends object>(
  key: (query: Filters) => readonly unknown[],
  query: MaybeRefOrGetter<Filters>,
  fetchPage: (query: Filters & { cursor?: string | undefined }, signal: AbortSignal) => Promise<Page<Item>>,
  enabled: () => boolean = () => true,
): List<Item> {
  const result = useInfiniteQuery({
    queryKey: computed(() => key(toValue(query))),
    queryFn: ({ pageParam, signal }) => fetchPage({ ...toValue(query), cursor: pageParam }, signal),
    initialPageParam: undefined as string | undefined,
    getNextPageParam: (last: Page<Item>) => last.next ?? undefined,
    placeholderData: keepPreviousData,
    enabled,
  });
  return {
    rows: computed(() => result.data.value?.pages.flatMap((page) => page.items) ?? []),
    total: computed(() => (result.isPlaceholderData.value ? null : (result.data.value?.pages[0]?.total ?? null))),
    isStale: computed(() => result.isPlaceholderData.value),
    hasMore: computed(() => result.hasNextPage.value),
    isLoading: computed(() => result.isPending.value),
    isLoadingMore: computed(() => result.isFetchingNextPage.value),
    problem: computed(() => (result.error.value === null ? null : toProblem(result.error.value))),
    loadMore: () => {
      if (result.hasNextPage.value && !result.isFetchingNextPage.value) void result.fetchNextPage();
    },
    reload: () => void result.refetch(),
  };
}
