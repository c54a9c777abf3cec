// Display of runs: the tone of each state, the duration, the equivalent commands, and their results.
import type { Run, RunState } from "@/api/types";
import { formatDuration, formatSize } from "@/components/format";
import { statusTones, verdictIcons, verdictTones, type Tone } from "@/components/tones";
import { texts as common } from "@/texts/common";
import { severityTones } from "@/components/warnings";
import { statusTexts } from "@/texts/checks";
import { severityTexts, stateTexts, texts } from "@/texts/runs";

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

export interface Chip {
  readonly label: string;
  readonly tone: Tone;
  readonly why: string;
  readonly icon?: string;
}

/** Returns the state of a run; one that is done, but found its mission bad or gave warnings, is not green. */
export function chipOf({ state, verdict, message }: Run): Chip {
  if (state === "done" && (verdict === "bad" || verdict === "warnings")) {
    return { label: texts.doneWith[verdict], tone: verdictTones[verdict], icon: verdictIcons[verdict], why: texts.doneWithWhy[verdict] };
  }
  return { label: stateTexts[state].label, tone: stateTones[state], why: message || stateTexts[state].why };
}

/** How long its command ran, so far where it still does. */
export function tookOf(run: Run, now: Date): string {
  if (run.started_at === null) return common.none;
  const end = run.ended_at === null ? now : new Date(run.ended_at);
  const milliseconds = Math.max(0, end.getTime() - new Date(run.started_at).getTime());
  return formatDuration(milliseconds < MS_PER_S ? milliseconds * NS_PER_MS : Math.round(milliseconds / MS_PER_S) * MS_PER_S * NS_PER_MS);
}

/** Returns the node and the job of a run on a cluster; empty where it has none. */
export function placeOf({ placement }: Pick<Run, "placement">): string {
  return [placement?.node ?? "", placement?.job_id ? texts.job(placement.job_id) : ""].filter((item) => item !== "").join(", ");
}

/** Returns what a run waits for, or what its preparation does at the moment, as a sentence; empty where it does neither. */
export function waitOf({ state, waits_for: waits, progress }: Pick<Run, "state" | "waits_for" | "progress">): string {
  const text = (waits ?? "") || (state === "preparing" ? (progress?.message ?? "") : "");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

export interface Fact {
  readonly label: string;
  readonly value: string;
}

/** Returns the name of a GPU: its UUID, or its number on the node. */
function gpuName(id: string): string {
  return /^\d+$/.test(id) ? texts.gpuNumber(id) : id;
}

/** Returns where a run is on its cluster or machine, and what that measured. */
export function placementFacts({ placement }: Pick<Run, "placement">): readonly Fact[] {
  if (!placement) return [];
  const { job_id: job, queued_s: queued, gpus, cpu_s: cpu, peak_memory_bytes: memory, requeues } = placement;
  const accounted = [typeof cpu === "number" ? texts.coreSeconds(cpu) : "", typeof memory === "number" ? texts.memoryAtMost(formatSize(memory)) : ""];
  const facts = [
    { label: texts.facts.job, value: job ?? "" },
    { label: texts.facts.queued, value: typeof queued === "number" ? formatDuration(Math.round(queued) * MS_PER_S * NS_PER_MS) : "" },
    { label: texts.facts.requeues, value: requeues > 0 ? texts.times(requeues) : "" },
    { label: texts.facts.gpus, value: gpus.map(gpuName).join(", ") },
    { label: texts.facts.accounted, value: accounted.filter((item) => item !== "").join(", ") },
  ];
  return facts.filter(({ value }) => value !== "");
}

const SEVERITIES = ["error", "warning", "info"] as const;
const FAILED = ["error", "warning", "not_made"] as const;

export interface Findings {
  readonly severity: (typeof SEVERITIES)[number];
  readonly label: string;
  readonly why: string;
  readonly tone: Tone;
}

/** Returns how many checks of a run failed or could not be made, the worst first. */
export function failedChecksOf({ check_counts: counts }: Run): readonly Chip[] {
  return FAILED.flatMap((status) => {
    const count = counts[status] ?? 0;
    return count === 0 ? [] : [{ label: texts.checkCount(count, status), tone: statusTones[status], why: statusTexts[status].why }];
  });
}

/** Returns how many findings of each severity a run has, the worst first; nothing where it has none. */
export function findingsOf({ finding_counts: counts }: Run): readonly Findings[] {
  return SEVERITIES.flatMap((severity) => {
    const count = counts[severity] ?? 0;
    const label = texts.findingCount(count, severity);
    return count === 0 ? [] : [{ severity, label, why: severityTexts[severity], tone: severityTones[severity] }];
  });
}

/** Returns the names of all metrics of some runs, those first that most runs have. */
export function metricNames(runs: readonly Run[]): readonly string[] {
  const counts = new Map<string, number>();
  for (const run of runs) {
    for (const name of new Set(run.metrics.map((metric) => metric.name))) counts.set(name, (counts.get(name) ?? 0) + 1);
  }
  return [...counts].sort(([one, ones], [other, others]) => others - ones || one.localeCompare(other)).map(([name]) => name);
}

const LARGE = 10_000;
const small = new Intl.NumberFormat("en-GB", { maximumSignificantDigits: 5 });
const large = new Intl.NumberFormat("en-GB", { maximumFractionDigits: 0 });

/** Returns a metric of a run with its unit: that of the whole run, or its only value; else how many values it has. */
export function metricText(run: Run, name: string): string {
  const metrics = run.metrics.filter((metric) => metric.name === name);
  const metric = metrics.find((item) => !item.file && !item.topic && Object.keys(item.labels).length === 0) ?? (metrics.length === 1 ? metrics[0] : undefined);
  if (metric === undefined) return metrics.length === 0 ? "" : texts.values(metrics.length);
  const format = Math.abs(metric.value) < LARGE ? small : large;
  return [format.format(metric.value), metric.unit ?? ""].filter((item) => item !== "").join(" ");
}
