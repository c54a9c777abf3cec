// How runs are told: by the tone of their state, by how long they took, by the commands that do the same.
import type { Run, RunState } from "@/api/types";
import { formatDuration } from "@/components/format";
import type { Tone } from "@/components/tones";
import { texts as common } from "@/texts/common";

const NS_PER_MS = 1_000_000;
const MS_PER_S = 1000;

export const stateTones: Readonly<Record<RunState, Tone>> = {
  queued: "plain",
  preparing: "accent",
  running: "accent",
  collecting: "accent",
  done: "good",
  failed: "bad",
  cancelled: "attention",
};

/** How long its command ran, so far where it still does. */
export function tookOf(run: Run, now: Date): string {
  if (run.started_at === null) return common.none;
  const end = run.ended_at === null ? now : new Date(run.ended_at);
  const milliseconds = Math.max(0, end.getTime() - new Date(run.started_at).getTime());
  return formatDuration(milliseconds < MS_PER_S ? milliseconds * NS_PER_MS : Math.round(milliseconds / MS_PER_S) * MS_PER_S * NS_PER_MS);
}

export interface Commands {
  readonly cli: string;
  readonly sdk: string;
}

/** The commands that do what the page of a run does. */
export function commandsOf(run: Run): Commands {
  const cli = [`klein run info ${run.id}`, `klein run logs ${run.id} -f`, `klein run artifacts ${run.id} --download DIRECTORY`].join("\n");
  const sdk = ["import kleinkram", "", "with kleinkram.connect() as client:", `    run = client.runs.get(${JSON.stringify(run.id)})`, "    print(run.state, run.message)"].join("\n");
  return { cli, sdk };
}
