/** Error codes of reading a recording. Their texts are in `texts/recordings.ts`. */

export type FailureCode =
  | "no_index"
  | "not_readable_here"
  | "compression_unknown"
  | "too_large"
  | "compressed_whole"
  | "chunk_damaged"
  | "index_damaged"
  | "topic_unknown"
  | "topic_silent"
  | "encoding_unknown"
  | "definition_missing"
  | "definition_unreadable"
  | "message_damaged"
  | "not_a_picture"
  | "picture_unreadable"
  | "picture_too_large"
  | "pixels_unknown"
  | "video_insecure"
  | "video_missing"
  | "video_codec"
  | "video_no_key_frame"
  | "not_spatial"
  | "cloud_unreadable"
  | "pose_unreadable"
  | "grid_unreadable"
  | "range_outside"
  | "not_sliceable"
  | "not_saved"
  | "store_unreachable"
  | "store_refused"
  | "file_changed"
  | "link_refused"
  | "worker_ended"
  | "worker_silent"
  | "cancelled";

/** A failure with a name; `detail` is what exactly, such as an encoding or an offset, for the sentence. */
export class ReadFailure extends Error {
  override readonly name = "ReadFailure";

  constructor(
    readonly code: FailureCode,
    readonly detail = "",
  ) {
    super(detail === "" ? code : `${code}: ${detail}`);
  }
}

/** Make a named failure of whatever was thrown; what has no name becomes `code`. */
export function failureOf(thrown: unknown, code: FailureCode): ReadFailure {
  if (thrown instanceof ReadFailure) return thrown;
  return new ReadFailure(code, thrown instanceof Error ? thrown.message.slice(0, 300) : "");
}
