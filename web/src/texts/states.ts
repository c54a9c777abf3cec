// Texts of states and rights, with their meaning.
import type { BlobState, ContentState, Right } from "@/api/types";

interface Named {
  readonly label: string;
  readonly why: string;
}

export const contentTexts: Readonly<Record<ContentState, Named>> = {
  pending: { label: "Not read yet", why: "The server has not read this file yet." },
  indexed: { label: "Indexed", why: "The content of this file is known and complete." },
  recovered: { label: "Recovered", why: "The file is damaged or was not closed. The readable content is known." },
  broken: { label: "Broken", why: "Nothing in this file is readable as a recording. The bytes are stored safely." },
  opaque: { label: "Other file", why: "Not a recording. The file is stored as is." },
  error: { label: "Read error", why: "The server failed to read this file and will retry." },
};

/** The mark of files that runs made. */
export const derivedText: Named = { label: "Derived", why: "A run made this from other files. It is not in the recorded time, messages, or statistics." };

export const blobTexts: Readonly<Record<BlobState, Named>> = {
  stored: { label: "Stored", why: "The store verified its checksum during the upload." },
  verified: { label: "Verified", why: "The server has read every byte and computed its checksums." },
  lost: { label: "Lost", why: "The store no longer has this file." },
  corrupt: { label: "Corrupt", why: "The stored bytes differ from the uploaded bytes." },
};

export const rightTexts: Readonly<Record<Right, Named>> = {
  READ: { label: "Read", why: "See and download." },
  CREATE: { label: "Create", why: "Also upload and create missions." },
  WRITE: { label: "Write", why: "Also edit, share, and grant rights." },
  DELETE: { label: "Delete", why: "Also delete, and everything else." },
};
