// Classes of isolation of runs, the strongest first, and which of them the server forbids.
import type { components } from "@/api/schema";

export type Isolation = components["schemas"]["Isolation"];

export const isolations = ["container", "namespaces", "none"] as const satisfies readonly Isolation[];

/** Whether a class is weaker than the weakest that the server allows. */
export function isForbidden(isolation: Isolation, weakest: Isolation): boolean {
  return isolations.indexOf(isolation) > isolations.indexOf(weakest);
}
