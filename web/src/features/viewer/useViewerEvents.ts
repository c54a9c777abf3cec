// The events of a mission and the findings of its runs in the viewer: the marks, and what the keys do with them.
import { computed, ref, shallowRef } from "vue";
import type { Clock } from "./clock";
import { timeText } from "./viewer";
import { linkSecret } from "@/api/client";
import { useMe } from "@/api/session";
import { useShortcuts } from "@/components/shortcuts";
import { showToast } from "@/components/toasts";
import { viewTimeNs, type EventTimes, type FindingWithTime, type MissionEvent } from "@/features/events/events";
import { gapsOf, marksOf, neighbour, openFindings, type Axis } from "@/features/events/marks";
import { useMissionEvents, useTimedFindings } from "@/features/events/queries";
import { hasRight, useMissionOf } from "@/features/file/queries";
import type { Span } from "@/recordings/formats/recording";
import { texts } from "@/texts/events";

/** What the form of an event begins with. */
export interface EventForm {
  readonly times: EventTimes;
  readonly event?: MissionEvent;
  readonly finding?: FindingWithTime;
}

/** Times this near are the same for the keys that go to the next mark. */
const NEAR_NS = 1_000;

export function useViewerEvents(missionId: string, clock: Clock, recorded: readonly Span[]) {
  const { me } = useMe();
  const mission = useMissionOf(() => (me.value === null ? undefined : missionId));
  const loadedEvents = useMissionEvents(() => missionId);
  const loadedFindings = useTimedFindings(() => missionId, () => me.value !== null);
  const axis: Axis = { startNs: Number(clock.span.fromNs), endNs: Number(clock.span.toNs) };
  const isOnAxis = (startNs: number, endNs = startNs) => endNs >= axis.startNs && startNs <= axis.endNs;
  const events = computed(() => loadedEvents.data.value?.filter(({ start_ns: start, end_ns: end }) => isOnAxis(start, end ?? start)) ?? []);
  const findings = computed(() => openFindings(events.value, loadedFindings.data.value?.findings.filter(({ finding }) => isOnAxis(finding.time_ns)) ?? []));
  const marks = computed(() => marksOf(events.value, findings.value));
  const right = computed(() => mission.data.value?.right);
  const mayAdd = computed(() => hasRight(right.value, "CREATE"));
  /** Where a span begins that has no end yet. */
  const begunNs = ref<number | null>(null);
  const begun = computed<Axis | null>(() => {
    if (begunNs.value === null) return null;
    const now = Number(clock.timeNs.value);
    return { startNs: Math.min(begunNs.value, now), endNs: Math.max(begunNs.value, now) };
  });
  const form = shallowRef<EventForm | null>(null);
  const isFormOpen = computed({ get: () => form.value !== null, set: (isOpen) => (form.value = isOpen ? form.value : null) });

  function open(next: EventForm): void {
    if (!mayAdd.value) return;
    clock.pause();
    form.value = next;
  }

  function addHere(): void {
    if (begun.value !== null) open({ times: begun.value });
    else open({ times: { startNs: Number(clock.timeNs.value), endNs: null } });
  }

  function begin(): void {
    if (!mayAdd.value) return;
    begunNs.value = Number(clock.timeNs.value);
    showToast({ tone: "plain", text: texts.begun(timeText(clock, clock.timeNs.value)) });
  }

  function end(): void {
    if (begun.value !== null) open({ times: begun.value });
    else if (mayAdd.value) showToast({ tone: "plain", text: texts.noBegin });
  }

  function go(which: "next" | "previous"): void {
    const mark = neighbour(marks.value, which, Number(clock.timeNs.value), NEAR_NS);
    if (mark === undefined) showToast({ tone: "plain", text: texts.noFurther });
    else clock.seek(viewTimeNs(mark.startNs));
  }

  const editing = [
    { keys: "e", does: texts.addKey, run: addHere },
    { keys: "[", does: texts.beginKey, run: begin },
    { keys: "]", does: texts.endKey, run: end },
  ];
  useShortcuts([
    ...(linkSecret() === null ? editing : []),
    { keys: "m", does: texts.nextKey, run: () => go("next") },
    { keys: "M", does: texts.previousKey, run: () => go("previous") },
  ]);

  return {
    missionId, axis, events, findings, marks, right, mayAdd, begunNs, begun, form, isFormOpen, open, addHere, begin, end,
    gaps: gapsOf(recorded),
    names: computed(() => [...new Set(events.value.map(({ name }) => name))]),
    isLoading: computed(() => loadedEvents.isPending.value),
    areFindingsCut: computed(() => loadedFindings.data.value?.isCut ?? false),
    error: computed(() => loadedEvents.error.value),
    reload: () => void loadedEvents.refetch(),
    timeText: (timeNs: number) => timeText(clock, BigInt(timeNs)),
  };
}

export type ViewerEvents = ReturnType<typeof useViewerEvents>;
