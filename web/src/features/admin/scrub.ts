// Where a scrub stands.
import type { components } from "@/api/schema";
import type { Tone } from "@/components/tones";

export type Scrub = components["schemas"]["ScrubRead"];
export type Standing = "waits" | "on" | "stopped" | "done";

export const standingTones: Readonly<Record<Standing, Tone>> = { waits: "plain", on: "accent", stopped: "bad", done: "good" };

/** Returns whether a scrub waits, goes on, was stopped or is done. */
export function standingOf(scrub: Pick<Scrub, "started_at" | "ended_at" | "stopped">): Standing {
  if (scrub.stopped !== null) return "stopped";
  if (scrub.ended_at !== null) return "done";
  return scrub.started_at === null ? "waits" : "on";
}

/** Returns whether there is a scrub that has not come to its end: another one would be the same. */
export function isOn(scrub: Pick<Scrub, "ended_at"> | null): boolean {
  return scrub !== null && scrub.ended_at === null;
}
