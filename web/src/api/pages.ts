// Lists that come in pages: the rows so far, and the next ones when somebody scrolls to where they would be.
import { keepPreviousData, useInfiniteQuery } from "@tanstack/vue-query";
import { computed, type ComputedRef, type MaybeRefOrGetter, toValue } from "vue";
import { type Problem, toProblem } from "./problem";
import type { Page } from "./types";

export interface Rows<Item> {
  readonly rows: ComputedRef<readonly Item[]>;
  /** How many there are in all, where the server was asked to count; null while that is not known. */
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
