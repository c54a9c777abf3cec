// The preview of an artifact, loaded once for all parts of the page that show it.
import { useQuery } from "@tanstack/vue-query";
import { computed } from "vue";
import { previewOf } from "./preview";
import type { PreviewArtifact } from "./queries";
import { toProblem } from "@/api/problem";
import { useObjectUrl } from "@/components/seen";

export function usePreview(artifact: () => PreviewArtifact | undefined, isEnabled: () => boolean) {
  const { data, error, refetch } = useQuery({
    queryKey: computed(() => ["previews", artifact()?.id ?? ""]),
    queryFn: ({ signal }) => previewOf(artifact() as PreviewArtifact, signal),
    enabled: () => artifact() !== undefined && isEnabled(),
    staleTime: "static", // artifacts never change
  });
  const address = useObjectUrl(() => (data.value?.kind === "picture" ? data.value.bytes : null));
  const problem = computed(() => (error.value === null ? null : toProblem(error.value)));
  return { shown: data, address, problem, again: () => void refetch() };
}
