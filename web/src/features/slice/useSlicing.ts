// Makes slices of one file in the browser, and saves them.
import { useQuery } from "@tanstack/vue-query";
import { computed, ref, shallowRef } from "vue";
import { removeEmpty, sliceName, type CutSelection } from "./selection";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { File } from "@/api/types";
import { saveFile } from "@/components/browser";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { MadeSlice, SliceProgress } from "@/recordings/protocol";
import type { RecordingReader } from "@/recordings/reader";

interface WithPicker {
  showSaveFilePicker?: (options: { suggestedName: string }) => Promise<FileSystemFileHandle>;
}

export function useSlicing(reader: RecordingReader) {
  const picker = (globalThis as WithPicker).showSaveFilePicker?.bind(globalThis);
  const service = useQuery({ queryKey: keys.service, queryFn: ({ signal }) => call(api.GET("/api/v1/service", { signal })) });
  const failure = shallowRef<ReadFailure | null>(null);
  /** The slice that is being made. */
  const run = shallowRef<AbortController | null>(null);
  const progress = ref<SliceProgress>({ share: 0, bytes: 0 });
  const saved = shallowRef<MadeSlice | null>(null);
  const isStopped = ref(false);

  async function save({ path, sha256 }: Pick<File, "path" | "sha256">, { topics, startNs, endNs }: CutSelection): Promise<void> {
    const version = service.data.value?.version;
    if (version === undefined) return;
    [failure.value, saved.value, isStopped.value, progress.value] = [null, null, false, { share: 0, bytes: 0 }];
    const controller = new AbortController();
    let handle: FileSystemFileHandle | null = null;
    try {
      handle = (await picker?.({ suggestedName: sliceName(path) })) ?? null;
      run.value = controller;
      const fileName = path.slice(path.lastIndexOf("/") + 1);
      const order = { topics: topics === null ? null : [...topics], startNs, endNs, fileName, sha256, version, handle };
      const made = await reader.request("slice", order, { signal: controller.signal, onSliced: (now) => (progress.value = now) });
      if (made.blob !== null) saveFile(sliceName(path), made.blob);
      saved.value = made;
    } catch (thrown) {
      if (handle !== null) await removeEmpty(handle);
      if (controller.signal.aborted) isStopped.value = true;
      else if (!(thrown instanceof DOMException && thrown.name === "AbortError")) failure.value = failureOf(thrown, "not_saved"); // else: no place was chosen
    }
    run.value = null;
  }

  return { canChoosePlace: picker !== undefined, isReady: computed(() => service.data.value !== undefined), failure, run, progress, saved, isStopped, save };
}
