// The byte ranges of one file, bound to the lifetime of a component.
import { onScopeDispose, ref, type Ref } from "vue";
import { addressOf } from "../viewer/useReader";
import { toProblem } from "@/api/problem";
import type { File } from "@/api/types";
import { ReadFailure } from "@/recordings/failures";
import { Ranges, type Address } from "@/recordings/ranges";

/** Returns a temporary URL of a file for its preview. @throws ReadFailure link_refused. */
export async function previewAddress(fileId: string): Promise<Address> {
  try {
    return await addressOf(fileId, "preview");
  } catch (thrown) {
    throw thrown instanceof ReadFailure ? thrown : new ReadFailure("link_refused", toProblem(thrown).code);
  }
}

export function useRanges(file: File): { readonly ranges: Ranges; /** Bytes that were fetched. */ readonly bytesRead: Ref<number> } {
  const bytesRead = ref(0);
  const ending = new AbortController();
  const ranges = new Ranges({
    sizeBytes: file.size_bytes,
    renew: () => previewAddress(file.id),
    onBytes: (count) => (bytesRead.value += count),
  });
  ranges.signal = ending.signal;
  onScopeDispose(() => ending.abort());
  return { ranges, bytesRead };
}
