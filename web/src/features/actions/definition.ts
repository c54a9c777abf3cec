// A definition in words.
import type { Definition, Parameter } from "@/api/types";
import { formatDuration, formatSize } from "@/components/format";
import { texts as all } from "@/texts/actions";

const texts = all.definition;
const NS_PER_S = 1_000_000_000;

/** Which files it reads. */
export function inputsOf({ inputs }: Definition): string {
  const parts = [
    inputs.paths.length > 0 ? texts.paths(inputs.paths.join(", ")) : "",
    inputs.topics.length > 0 ? texts.topics(inputs.topics.join(", ")) : "",
    inputs.message_types.length > 0 ? texts.types(inputs.message_types.join(", ")) : "",
  ].filter((item) => item !== "");
  return parts.length === 0 ? texts.all : parts.join(", ");
}

/** What it may use at most. */
export function resourcesOf({ resources }: Definition): string {
  return [
    texts.cores(resources.cores),
    texts.memory(formatSize(resources.memory_bytes)),
    texts.disk(formatSize(resources.disk_bytes)),
    ...(resources.gpus > 0 ? [texts.gpus(resources.gpus)] : []),
    texts.time(formatDuration(resources.time_s * NS_PER_S)),
    ...(resources.labels.length > 0 ? [texts.labels(resources.labels.join(", "))] : []),
  ].join(", ");
}

/** What values a parameter takes, beyond its type. */
export function boundsOf({ minimum, maximum, choices }: Parameter): string {
  if (choices) return choices.join(", ");
  const [least, most] = [minimum ?? null, maximum ?? null];
  if (least !== null && most !== null) return texts.between(least, most);
  if (least !== null) return texts.atLeast(least);
  return most !== null ? texts.atMost(most) : "";
}

/** What a parameter is unless somebody says otherwise. */
export function presetOf({ default: preset, unit }: Parameter): string {
  if (preset === null || preset === undefined) return texts.must;
  if (typeof preset === "boolean") return all.launch[preset ? "yes" : "no"].toLowerCase();
  return unit ? `${preset} ${unit}` : String(preset);
}
