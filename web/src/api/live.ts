// Live updates: events of the server say which type of resource changed, and the queries of that type are refetched.
import { useQueryClient } from "@tanstack/vue-query";
import { onScopeDispose, ref, watch, type Ref, type WatchSource } from "vue";
import { isSignInRequired } from "./client";
import { keys } from "./queries";
import { useMe } from "./session";

/** Changes within this time cause one refetch. */
const GATHER_MS = 250;
/** The minimum time between refetches during constant changes. */
const MIN_MS = 2000;
/** The same for answers that cost more, and change little with most changes. */
const SLOW_MIN_MS = 15_000;
const SLOW: ReadonlySet<unknown> = new Set(["mission-positions"]);
/** The time after which a rejected stream is tried again: the user may have signed in. */
const POLL_MS = 5000;

export interface LiveOptions {
  /** The query keys that an event invalidates. */
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

export interface Refetching {
  readonly add: (key: readonly unknown[]) => void;
  readonly stop: () => void;
}

/** Gathers keys, and hands them over together, at most once in `minMs`. */
export function refetching(minMs: number, refetch: (key: readonly unknown[]) => void): Refetching {
  let timer: ReturnType<typeof setTimeout> | undefined;
  let refetchedAt = -minMs;
  const old = new Map<string, readonly unknown[]>();

  function refetchAll(): void {
    timer = undefined;
    refetchedAt = performance.now();
    for (const key of old.values()) refetch(key);
    old.clear();
  }

  function add(key: readonly unknown[]): void {
    old.set(JSON.stringify(key), key);
    timer ??= setTimeout(refetchAll, Math.max(GATHER_MS, refetchedAt + minMs - performance.now()));
  }

  return { add, stop: () => clearTimeout(timer) };
}

/** Listens to a stream of events at a path, for as long as the component lives; a path of null listens to nothing. */
export function useLive(path: WatchSource<string | null>, options: LiveOptions): Live {
  const queries = useQueryClient();
  const breaks = ref(0);
  let source: EventSource | null = null;
  let again: ReturnType<typeof setTimeout> | undefined;
  let isBroken = false;
  const refetch = (queryKey: readonly unknown[]): void => void queries.invalidateQueries({ queryKey });
  const [often, seldom] = [refetching(MIN_MS, refetch), refetching(SLOW_MIN_MS, refetch)];

  function note(event: MessageEvent<string>): void {
    for (const key of options.keysOf(event.type, parsed(event.data))) (SLOW.has(key[0]) ? seldom : often).add(key);
  }

  function connected(): void {
    if (isBroken) void queries.invalidateQueries(); // events in between were missed
    isBroken = false;
  }

  /** A browser connects again by itself where the line broke, and never again where it was refused. */
  function broken(at: string): void {
    breaks.value += 1;
    isBroken = true;
    clearTimeout(again);
    if (source?.readyState === EventSource.CLOSED) again = setTimeout(() => isSignInRequired.value || open(at), POLL_MS);
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
  // The stream belongs to a session: open another one for the session that just began.
  watch(isSignInRequired, (isRequired) => {
    if (!isRequired && source !== null) {
      isBroken = true;
      open(source.url);
    }
  });
  onScopeDispose(() => {
    often.stop();
    seldom.stop();
    close();
  });
  return { breaks };
}

type Key = readonly unknown[];

interface Change {
  readonly resource_type: string;
  readonly id: string | null;
  readonly mission_id: string | null;
  readonly project_id: string | null;
}

/** Where missions are on a map: the files, metadata and rights of any may move, show or hide one. */
const POSITIONS: Key = ["mission-positions"];
/** An answer whose key begins with nothing is any. */
const EVERYTHING: readonly Key[] = [[]];

function isChange(value: unknown): value is Change {
  return typeof value === "object" && value !== null && "resource_type" in value;
}

function inMission(change: Change): Key[] {
  const list: Key[] = [["missions", "list"], ["projects", "list"], ["stats"]];
  return change.mission_id === null ? [["missions"], ...list] : [keys.mission(change.mission_id), ...list];
}

const OF_RESOURCE_TYPES: Readonly<Record<string, (change: Change) => readonly Key[]>> = {
  file: (change) => [...inMission(change), POSITIONS, ["files", "list"], ["trash"], ...(change.id === null ? [["files", "one"]] : [keys.file(change.id)])],
  recording: (change) => [...inMission(change), ["files", "list"]],
  upload: (change) => (change.mission_id === null ? [] : [keys.uploads(change.mission_id)]),
  mission_event: () => [["mission-events"]],
  viewer_layout: () => [["viewer-layouts"]],
  mission: (change) => [change.id === null ? ["missions"] : keys.mission(change.id), ["missions", "list"], POSITIONS, ["projects"], ["trash"], ["stats"]],
  project: () => [["projects"], ["missions"], POSITIONS, ["trash"], ["stats"]],
  run: (change) => [
    ["runs", "list"],
    change.id === null ? ["runs"] : keys.run(change.id),
    ...(change.id === null ? [] : [["files", "one"]]),
    ...(change.mission_id === null ? [] : [keys.missionPreviews(change.mission_id)]),
  ],
  action: () => [["actions"]],
  grant: () => [["access"], ["projects"], ["missions"], POSITIONS],
  share: () => [["shares"]],
  group: () => [["groups"], ["access"]],
  person: () => [["people"], ["groups"]],
  token: () => [["tokens"]],
  session: () => [["sessions"]],
};

/** Returns the keys of the answers that an event makes old. */
export function keysOf(kind: string, data: unknown): readonly Key[] {
  if (kind === "refetch") return EVERYTHING;
  return isChange(data) ? (OF_RESOURCE_TYPES[data.resource_type]?.(data) ?? []) : [];
}

/** Keeps the shown data current while the user is signed in and the window is visible. */
export function useChanges(): Live {
  const { me } = useMe();
  const isSeen = ref(document.visibilityState === "visible");
  const updateVisibility = () => (isSeen.value = document.visibilityState === "visible");
  document.addEventListener("visibilitychange", updateVisibility);
  onScopeDispose(() => document.removeEventListener("visibilitychange", updateVisibility));
  return useLive(() => (me.value !== null && isSeen.value ? "/api/v1/events" : null), { kinds: ["change", "refetch"], keysOf });
}
