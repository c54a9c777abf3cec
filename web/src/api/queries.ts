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

declare module "@tanstack/vue-query" {
  interface Register {
    defaultError: Error;
    /** `showsItself`: the page shows failures itself; otherwise a toast does. */
    mutationMeta: { showsItself?: boolean };
  }
}

/** Returns a store of answers. */
export function openQueries(): QueryClient {
  return new QueryClient({
    defaultOptions: {
      queries: {
        staleTime: FRESH_MS,
        retry: shouldRetry,
        retryDelay: (failures) => Math.min(8000, 500 * 2 ** failures),
        // An answer is replaced as a whole, never changed: to watch each number in it makes lists slow.
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
  missionGrants: (id: string) => ["access", "mission", id, "grants"],
  missionAccess: (id: string) => ["access", "mission", id, "who"],
  recordings: (missionId: string) => ["missions", "one", missionId, "recordings"],
  uploads: (missionId: string) => ["missions", "one", missionId, "uploads"],
  files: (query: Query = {}) => ["files", "list", query],
  file: (id: string) => ["files", "one", id],
  fileTopics: (id: string) => ["files", "one", id, "topics"],
  topics: (query: Query = {}) => ["topics", "list", query],
  actions: (query: Query = {}) => ["actions", "list", query],
  action: (id: string) => ["actions", "one", id],
  runs: (query: Query = {}) => ["runs", "list", query],
  run: (id: string) => ["runs", "one", id],
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

export interface Rows<Item> {
  readonly rows: ComputedRef<readonly Item[]>;
  /** The total, if the request included a count; null until it is known. */
  readonly total: ComputedRef<number | null>;
  /** Whether the rows are of an earlier question, and stay in sight until those of this one are there. */
  readonly isOld: ComputedRef<boolean>;
  readonly hasMore: ComputedRef<boolean>;
  readonly isLoading: ComputedRef<boolean>;
  readonly isLoadingMore: ComputedRef<boolean>;
  readonly problem: ComputedRef<Problem | null>;
  readonly more: () => void;
  readonly again: () => void;
}

/** Returns the rows of a list. `fetchPage` gets the cursor of the page that is wanted, undefined for the first. */
export function usePages<Item>(
  key: MaybeRefOrGetter<readonly unknown[]>,
  fetchPage: (cursor: string | undefined, signal: AbortSignal) => Promise<Page<Item>>,
  options: { readonly enabled?: MaybeRefOrGetter<boolean> } = {},
): Rows<Item> {
  const query = useInfiniteQuery({
    queryKey: computed(() => toValue(key)),
    queryFn: ({ pageParam, signal }) => fetchPage(pageParam, signal),
    initialPageParam: undefined as string | undefined,
    getNextPageParam: (last: Page<Item>) => last.next ?? undefined,
    placeholderData: keepPreviousData,
    enabled: () => toValue(options.enabled) ?? true,
  });
  return {
    rows: computed(() => query.data.value?.pages.flatMap((page) => page.items) ?? []),
    total: computed(() => (query.isPlaceholderData.value ? null : (query.data.value?.pages[0]?.total ?? null))),
    isOld: computed(() => query.isPlaceholderData.value),
    hasMore: computed(() => query.hasNextPage.value),
    isLoading: computed(() => query.isPending.value),
    isLoadingMore: computed(() => query.isFetchingNextPage.value),
    problem: computed(() => (query.error.value === null ? null : toProblem(query.error.value))),
    more: () => {
      if (query.hasNextPage.value && !query.isFetchingNextPage.value) void query.fetchNextPage();
    },
    again: () => void query.refetch(),
  };
}
