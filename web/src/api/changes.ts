// What each change on the server makes old here. One stream for the whole app, while somebody looks at it.
import { onScopeDispose, ref } from "vue";
import { keys } from "./keys";
import { type Live, useLive } from "./live";
import { useMe } from "./session";

type Key = readonly unknown[];

interface Change {
  readonly noun: string;
  readonly id: string | null;
  readonly mission_id: string | null;
  readonly project_id: string | null;
}

/** An answer whose key begins with nothing is any. */
const EVERYTHING: readonly Key[] = [[]];

function isChange(value: unknown): value is Change {
  return typeof value === "object" && value !== null && "noun" in value;
}

function inMission(change: Change): Key[] {
  const list: Key[] = [["missions", "list"], ["projects", "list"], ["stats"]];
  return change.mission_id === null ? [["missions"], ...list] : [keys.mission(change.mission_id), ...list];
}

const OF_NOUNS: Readonly<Record<string, (change: Change) => readonly Key[]>> = {
  file: (change) => [...inMission(change), ["files", "list"], ["trash"], ...(change.id === null ? [["files", "one"]] : [keys.file(change.id)])],
  recording: (change) => [...inMission(change), ["files", "list"]],
  upload: (change) => (change.mission_id === null ? [] : [keys.uploads(change.mission_id)]),
  mission: (change) => [change.id === null ? ["missions"] : keys.mission(change.id), ["missions", "list"], ["projects"], ["trash"], ["stats"]],
  project: () => [["projects"], ["missions"], ["trash"], ["stats"]],
  run: (change) => [["runs", "list"], change.id === null ? ["runs"] : keys.run(change.id), ...(change.id === null ? [] : [["files", "one"]])],
  action: () => [["actions"]],
  grant: () => [["access"], ["projects"], ["missions"]],
  share: () => [["shares"]],
  group: () => [["groups"], ["access"]],
  person: () => [["people"], ["groups"]],
  token: () => [["tokens"]],
  session: () => [["sessions"]],
};

/** Returns the keys of the answers that an event makes old. */
export function keysOf(kind: string, data: unknown): readonly Key[] {
  if (kind === "refetch") return EVERYTHING;
  return isChange(data) ? (OF_NOUNS[data.noun]?.(data) ?? []) : [];
}

/** Keeps what is shown current, for whoever is signed in. A window that nobody sees listens to nothing. */
export function useChanges(): Live {
  const { me } = useMe();
  const isSeen = ref(document.visibilityState === "visible");
  const look = () => (isSeen.value = document.visibilityState === "visible");
  document.addEventListener("visibilitychange", look);
  onScopeDispose(() => document.removeEventListener("visibilitychange", look));
  return useLive(() => (me.value !== null && isSeen.value ? "/api/v1/events" : null), { kinds: ["change", "refetch"], keysOf });
}
