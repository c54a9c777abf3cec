// A file about to be announced: what the journal remembers of it, and its checksums where they are known.

import type { Hashing, WholeSums } from "./checksums";
import type { JournalFile } from "./journal";
import type { PlannedFile, UploadFile } from "./types";
import { MIN_PART_BYTES } from "./types";
import { checkUnchanged, slices } from "./reading";

export class Candidate {
  sums: WholeSums | null = null;
  private uploadId: string | null;
  /** The checksum of a file that was there before the reload, where it still is the same file. */
  private doneSha256: string | null = null;

  constructor(
    readonly planned: PlannedFile,
    private readonly remembered: JournalFile | null,
  ) {
    this.uploadId = remembered?.uploadId ?? null;
    const isSame =
      remembered?.sizeBytes === planned.identity.sizeBytes && remembered.modifiedMs === planned.identity.modifiedMs;
    if (isSame && remembered.state === "done") this.doneSha256 = remembered.sha256;
  }

  get sha256(): string | null {
    return this.sums?.sha256 ?? this.doneSha256;
  }

  /** Whether it is read before it is announced, so that it is decided in one answer. */
  get isSmall(): boolean {
    return this.doneSha256 === null && this.planned.identity.sizeBytes <= MIN_PART_BYTES;
  }

  /** Return the upload that was begun with another size, which cannot go on; it is forgotten. */
  dropOtherSize(): string | null {
    if (this.remembered === null || this.remembered.sizeBytes === this.planned.identity.sizeBytes) return null;
    const lost = this.uploadId;
    this.uploadId = null;
    return lost;
  }

  /** Forget the upload begun earlier; return whether there was one. */
  forgetUpload(): boolean {
    const was = this.uploadId !== null;
    this.uploadId = null;
    return was;
  }

  /** Return what the server is told. */
  announcement(): UploadFile {
    const { path, identity } = this.planned;
    return { path, size_bytes: identity.sizeBytes, sha256: this.sha256, upload_id: this.uploadId };
  }

  /** Read all of the file for its checksums; `read` hears of each slice and may hold or end it. @throws FileFailure */
  async hashWhole(hashing: Hashing, read: (sizeBytes: number) => Promise<void>): Promise<void> {
    hashing.beginWhole();
    for await (const bytes of slices(this.planned, 0, this.planned.identity.sizeBytes)) {
      await read(bytes.length);
      hashing.addToWhole(bytes);
    }
    this.sums = hashing.endWhole();
    await checkUnchanged(this.planned);
  }
}
