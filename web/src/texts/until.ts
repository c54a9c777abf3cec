// Texts of expiry dates.
import type { Span } from "@/components/until";

const spans: Readonly<Record<Span, string>> = { 1: "Until tomorrow", 30: "For 30 days", 90: "For 90 days", 365: "For a year" };

export const texts = { never: "No expiry", spans, day: "Until a date…", dayLabel: "Last day" } as const;
