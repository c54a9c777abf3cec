// How answers are kept and asked for anew, for the whole app.
import { MutationCache, QueryClient } from "@tanstack/vue-query";
import { Problem, toProblem } from "./problem";
import { tell } from "@/components/toasts";

const FRESH_MS = 15_000;
const TRIES = 3;

function shouldRetry(failures: number, thrown: unknown): boolean {
  return failures < TRIES && thrown instanceof Problem && thrown.isPassing;
}

declare module "@tanstack/vue-query" {
  interface Register {
    defaultError: Error;
    /** `showsItself`: the page shows what goes wrong beside what was done; else it is told at the window's edge. */
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
        if (mutation.options.meta?.showsItself !== true) tell({ tone: "bad", text: toProblem(error).message });
      },
    }),
  });
}
