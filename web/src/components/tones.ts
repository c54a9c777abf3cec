// Tones of states, and their icon and color.
import { iconAttention, iconBad, iconGood } from "./icons";
import type { BlobState, ContentState } from "@/api/types";

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
