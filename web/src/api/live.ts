// What changes on the server shows here by itself: events say which noun changed, and its answers are asked for anew.
import { useQueryClient } from "@tanstack/vue-query";
import { onScopeDispose, ref, type Ref, watch, type WatchSource } from "vue";
import { isAskingToSignIn } from "./signing-in";

/** Several changes within this time ask for everything once. */
const GATHER_MS = 250;
/** Where changes come all the time, everything is asked for no more often than this. */
const LEAST_MS = 2000;
/** After this time a stream that the server refused is asked for again: somebody may have signed in anew. */
const AGAIN_MS = 5000;

export interface LiveOptions {
  /** Which answers an event makes old; none for events that are nobody's concern here. */
  readonly keysOf: (kind: string, data: unknown) => readonly (readonly unknown[])[];
  /** Names of the events that are listened to. */
  readonly kinds: readonly string[];
}

export interface Live {
  /** How often the line broke. */
  readonly breaks: Readonly<Ref<number>>;
}

function parsed(text: string): unknown {
  try {
    return JSON.parse(text) as unknown;
  } catch {
    return null;
  }
}

/** Listens to a stream of events at a path, for as long as the component lives; a path of null listens to nothing. */
export function useLive(path: WatchSource<string | null>, options: LiveOptions): Live {
  const queries = useQueryClient();
  const breaks = ref(0);
  let source: EventSource | null = null;
  let timer: ReturnType<typeof setTimeout> | undefined;
  let again: ReturnType<typeof setTimeout> | undefined;
  let refreshedAt = -LEAST_MS;
  let isBroken = false;
  const old = new Map<string, readonly unknown[]>();

  function refresh(): void {
    timer = undefined;
    refreshedAt = performance.now();
    for (const queryKey of old.values()) void queries.invalidateQueries({ queryKey });
    old.clear();
  }

  function note(event: MessageEvent<string>): void {
    for (const key of options.keysOf(event.type, parsed(event.data))) old.set(JSON.stringify(key), key);
    if (old.size > 0) timer ??= setTimeout(refresh, Math.max(GATHER_MS, refreshedAt + LEAST_MS - performance.now()));
  }

  function connected(): void {
    if (isBroken) void queries.invalidateQueries(); // what changed meanwhile was told to nobody
    isBroken = false;
  }

  /** A browser connects again by itself where the line broke, and never again where it was refused. */
  function broken(at: string): void {
    breaks.value += 1;
    isBroken = true;
    clearTimeout(again);
    if (source?.readyState === EventSource.CLOSED) again = setTimeout(() => isAskingToSignIn.value || open(at), AGAIN_MS);
  }

  function close(): void {
    clearTimeout(again);
    source?.close();
    source = null;
  }

  function open(at: string | null): void {
    close();
    if (at === null) return;
    source = new EventSource(at);
    source.addEventListener("open", connected);
    source.addEventListener("error", () => broken(at));
    for (const kind of options.kinds) source.addEventListener(kind, note);
  }

  watch(path, open, { immediate: true });
  // What is told is told to a session: to the one that just began, anew.
  watch(isAskingToSignIn, (isAsking) => {
    if (!isAsking && source !== null) {
      isBroken = true;
      open(source.url);
    }
  });
  onScopeDispose(() => {
    clearTimeout(timer);
    close();
  });
  return { breaks };
}
