// Reads all messages of a part of the time, one page after the other.
import type { Series } from "../layout";
import type { MessagesIn, Sources } from "../sources";
import type { ProductName, ReadMessage } from "@/recordings/products/products";
import type { RequestOptions } from "@/recordings/reader";

/** Requests for one part of the time. */
export const MAX_PAGES = 4;

/** Calls `onMessage` in the order of time. Returns up to where it read: before `toNs` where that takes more than `MAX_PAGES` requests. */
export async function readPages<P extends ProductName>(
  sources: Sources,
  series: Series,
  request: MessagesIn<P>,
  options: RequestOptions,
  onMessage: (message: ReadMessage<P>) => void,
): Promise<bigint> {
  let pages = 0;
  for (const file of sources.filesOf(series)) {
    let fromNs = file.span.fromNs > request.fromNs ? file.span.fromNs : request.fromNs;
    const toNs = file.span.toNs < request.toNs ? file.span.toNs : request.toNs;
    for (; fromNs <= toNs; pages += 1) {
      if (pages >= MAX_PAGES) return fromNs - 1n;
      const answer = await sources.messages(file, series, { ...request, fromNs, toNs }, options);
      answer?.messages.forEach(onMessage);
      fromNs = (answer?.untilNs ?? toNs) + 1n;
    }
  }
  return request.toNs;
}
