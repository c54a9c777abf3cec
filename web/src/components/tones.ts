// Tones of states, and their icon and color.
import { iconAccepted, iconAttention, iconBad, iconGood, iconNone, iconOutdated, iconProgress, iconUnknown } from "./icons";
import type { BlobState, CellStatus, ContentState, Verdict } from "@/api/types";

export type Tone = "plain" | "accent" | "good" | "attention" | "bad";

export const toneIcons: Readonly<Record<Tone, string>> = {
  plain: "",
  accent: "",
  good: iconGood,
  attention: iconAttention,
  bad: iconBad,
};

export const contentTones: Readonly<Record<ContentState, Tone>> = {
  pending: "plain",
  indexed: "good",
  recovered: "attention",
  broken: "bad",
  opaque: "plain",
  error: "bad",
};

export const blobTones: Readonly<Record<BlobState, Tone>> = {
  stored: "plain",
  verified: "good",
  lost: "bad",
  corrupt: "bad",
};

export const verdictTones: Readonly<Record<Verdict, Tone>> = {
  good: "good",
  warnings: "attention",
  bad: "bad",
  outdated: "plain",
  running: "accent",
  unchecked: "plain",
};

export const verdictIcons: Readonly<Record<Verdict, string>> = {
  good: iconGood,
  warnings: iconAttention,
  bad: iconBad,
  outdated: iconOutdated,
  running: iconProgress,
  unchecked: iconNone,
};

export const statusTones: Readonly<Record<CellStatus, Tone>> = {
  ok: "good",
  warning: "attention",
  error: "bad",
  not_made: "attention",
  accepted: "accent",
  needs_content: "plain",
};

export const statusIcons: Readonly<Record<CellStatus, string>> = {
  ok: iconGood,
  warning: iconAttention,
  error: iconBad,
  not_made: iconUnknown,
  accepted: iconAccepted,
  needs_content: iconNone,
};
