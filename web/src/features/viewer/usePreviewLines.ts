// The lines that the previews of a large recording have of a topic: the first and the most severe ones.
import { onScopeDispose, shallowRef, watch, type Ref } from "vue";
import { PLOT_BYTES } from "./curves";
import type { Series } from "./layout";
import { roughLines, type Line } from "./log_lines";
import { useViewer } from "./viewer";

/** Reads the lines of a series; none of a small recording, whose messages are read anyway. */
export function usePreviewLines(series: () => Series | undefined): Readonly<Ref<readonly Line[]>> {
  const { sources, previews } = useViewer();
  const lines = shallowRef<readonly Line[]>([]);
  let controller = new AbortController();

  async function read(): Promise<void> {
    controller.abort();
    controller = new AbortController();
    const { signal } = controller;
    lines.value = [];
    const source = series();
    const files = sources.recordings.find(({ key }) => key === source?.recording)?.files ?? [];
    if (source === undefined || files.reduce((sum, file) => sum + file.size_bytes, 0) <= PLOT_BYTES) return;
    for (const file of files) {
      // A preview that cannot be read is as good as none.
      const preview = await previews.of(file.id).catch(() => null);
      const ofTopic = (await preview?.lines(source.topic).catch(() => [])) ?? [];
      if (signal.aborted) return;
      lines.value = [...lines.value, ...roughLines(ofTopic)];
    }
  }

  watch(() => `${series()?.recording} ${series()?.topic}`, read, { immediate: true });
  onScopeDispose(() => controller.abort());
  return lines;
}
