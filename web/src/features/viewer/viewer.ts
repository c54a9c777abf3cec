// What the panels of the viewer share: the clock, the recordings, and which panel is selected.
import { inject, type InjectionKey, type Ref } from "vue";
import type { Clock } from "./clock";
import type { NamedPosition } from "./locations";
import type { Previews } from "./previews";
import type { ViewerTopic } from "./queries";
import type { Sources } from "./sources";
import { formatUtc } from "@/components/format";
import { texts } from "@/texts/viewer";

export interface Viewer {
  readonly clock: Clock;
  readonly sources: Sources;
  readonly previews: Previews;
  readonly topics: readonly ViewerTopic[];
  /** Places in the metadata of the mission. */
  readonly locations: readonly NamedPosition[];
  /** The place of the panel whose messages the keys `,` and `.` step through. */
  readonly selected: Ref<number>;
}

export const viewerKey: InjectionKey<Viewer> = Symbol("viewer");

export function useViewer(): Viewer {
  const viewer = inject(viewerKey);
  if (viewer === undefined) throw new Error("outside of a viewer");
  return viewer;
}

/** Bytes that a search for one message reads at most. */
export const MAX_SEARCH_BYTES = 16 * 2 ** 20;
/** What is read for a time that is this far from the play head is out of date: a step of the arrow keys. */
const FAR_NS = 1_000_000_000n;
const NS_PER_S = 1e9;

/** Whether somebody jumped from one time to the other: while playing, steps are shorter. */
export function areFar(oneNs: bigint, otherNs: bigint): boolean {
  return oneNs - otherNs >= FAR_NS || otherNs - oneNs >= FAR_NS;
}

/** Returns seconds since the beginning of the viewer's time. */
export function secondsOf({ span }: Clock, timeNs: bigint): number {
  return Number(timeNs - span.fromNs) / NS_PER_S;
}

/** Returns the log time of seconds since the beginning. */
export function timeAt({ span }: Clock, seconds: number): bigint {
  return span.fromNs + BigInt(Math.round(seconds * NS_PER_S));
}

/** Seconds say little in a mission that is longer than this. */
const LONG_SECONDS = 2 * 86_400;

/** Returns a time for people: seconds since the beginning, or the date where that is long ago. */
export function timeText(clock: Clock, timeNs: bigint): string {
  const isLong = secondsOf(clock, clock.span.toNs) > LONG_SECONDS;
  return isLong ? formatUtc(new Date(Number(timeNs / 1_000_000n))) : texts.seconds(secondsOf(clock, timeNs));
}
