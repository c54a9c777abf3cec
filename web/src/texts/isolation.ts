// Texts of the classes of isolation of runs.
import type { components } from "@/api/schema";

type Isolation = components["schemas"]["Isolation"];

export const isolationTexts: Readonly<Record<Isolation, { readonly label: string; readonly short: string; readonly why: string }>> = {
  container: {
    label: "Containers",
    short: "Containers",
    why: "Each run sees only its own files, programs and network. It shares the machine's kernel, so a fault of the kernel can still let it out.",
  },
  namespaces: {
    label: "Namespaces, without containers",
    short: "Namespaces",
    why: "Each run sees only its own files and processes, and the machine's programs. On a cluster, runs have the user of one account: only the namespaces separate them, and limits of memory and disk can be weaker.",
  },
  none: {
    label: "No isolation",
    short: "None",
    why: "Nothing separates a run from its machine: it can read and change whatever its runner can, such as inputs and results of other runs. Only for code that you trust fully.",
  },
};
