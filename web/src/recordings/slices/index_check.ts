/** Refuses recordings with a wrong index: by its times, a reader would miss messages. `klein cut` corrects such an index. */

import { ReadFailure } from "../failures";
import type { Message, Recording } from "../formats/recording";

/** Chunks that are read if none seems to hold the selection, as `MAX_COMPARED_REMOTE` in recordings/chunk_index_check.py. */
const MAX_COMPARED = 16;
const END_OF_TIME = 2n ** 64n - 1n;

/** @throws ReadFailure not_sliceable, if a message has another time than the index says of its chunk. */
export function checkTime({ logTimeNs, chunkSpan: { fromNs, toNs } }: Message): void {
  if (logTimeNs < fromNs || logTimeNs > toNs) throw wrongIndex();
}

/** Reads some chunks, at even distances. @throws ReadFailure not_sliceable, and what reading may. */
export async function checkEmptySelection(recording: Recording): Promise<void> {
  const topics = recording.topics.map(({ name }) => name);
  const pieces = recording.pieces(topics, { fromNs: 0n, toNs: END_OF_TIME });
  const step = Math.max(1, Math.ceil(pieces.length / MAX_COMPARED));
  for (const piece of pieces.filter((_, number) => number % step === 0)) {
    for (const message of await recording.readPiece(piece, topics)) {
      checkTime(message);
      if (piece.topics?.has(message.channel.topic) === false) throw wrongIndex();
    }
  }
}

function wrongIndex(): ReadFailure {
  return new ReadFailure("not_sliceable", "its index is wrong");
}
