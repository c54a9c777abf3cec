// The words for states, and what they mean.
import type { BlobState, ContentState, Right } from "@/api/types";

interface Named {
  readonly label: string;
  readonly why: string;
}

export const contentTexts: Readonly<Record<ContentState, Named>> = {
  pending: { label: "Not read yet", why: "Nobody has read yet what is in this file." },
  indexed: { label: "Whole", why: "What is in this file is known, and all of it is there." },
  recovered: { label: "Recovered", why: "The file is damaged or was never closed; what is readable of it is known." },
  broken: { label: "Broken", why: "Nothing in this file can be read as a recording. Its bytes are safe." },
  opaque: { label: "Other file", why: "This is no recording; it is kept as it is." },
  error: { label: "Could not be read", why: "Reading it failed on our side; it is tried again." },
};

export const blobTexts: Readonly<Record<BlobState, Named>> = {
  stored: { label: "Stored", why: "The store's own checksums agreed when it came in." },
  verified: { label: "Verified", why: "The server has read every byte and holds their checksums." },
  lost: { label: "Lost", why: "The store no longer has these bytes." },
  corrupt: { label: "Corrupt", why: "The bytes in the store are not those that came in." },
};

export const rightTexts: Readonly<Record<Right, Named>> = {
  READ: { label: "Read", why: "See and download." },
  CREATE: { label: "Create", why: "Also upload and make missions." },
  WRITE: { label: "Write", why: "Also change, share and say who may." },
  DELETE: { label: "Own", why: "Also delete, and everything else." },
};
