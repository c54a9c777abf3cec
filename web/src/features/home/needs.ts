// Where somebody goes for what needs them.
import type { RouteLocationRaw } from "vue-router";
import type { Attention } from "./queries";
import type { Tone } from "@/components/tones";

type Need = Attention["need"];

export const needTones: Readonly<Record<Need, Tone>> = {
  files_corrupt: "bad",
  files_lost: "bad",
  files_broken: "bad",
  files_unread: "attention",
  files_recovered: "attention",
  runs_cannot_start: "bad",
  runs_failed: "attention",
  metadata_missing: "attention",
  scrub_stopped: "bad",
  verifications_overdue: "attention",
  jobs_failed: "bad",
  disk_low: "bad",
};

/** Returns the view in which something is seen and mended: the mission's own, or for the whole server the admin's. */
export function placeOf({ need, mission }: Attention): RouteLocationRaw {
  if (mission === null || mission === undefined) return { name: "admin", query: need === "scrub_stopped" ? { tab: "scrub" } : {} };
  if (need === "runs_cannot_start" || need === "runs_failed") {
    return { name: "mission", params: { missionId: mission.id }, query: { tab: "runs" } };
  }
  const query = need === "metadata_missing" ? {} : { tab: "problems" };
  return { name: "mission", params: { missionId: mission.id }, query };
}
