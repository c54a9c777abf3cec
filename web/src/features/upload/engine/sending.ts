// One file's upload under way: which parts are left, what has been hashed, and whether it has ended.

import type { Hashing, WholeSums } from "./checksums";
import type { StoredPart, JournalPart } from "./journal";
import type { PartToSign, PlannedFile, UploadFinish, UploadRead } from "./nouns";
import { slices } from "./reading";

/** A part that is to be sent. */
export interface Part {
  readonly sending: Sending;
  readonly number: number;
  readonly offset: number;
  readonly sizeBytes: number;
  readonly checksum: string;
  readonly cost: number;
}

/** Return what the server signs. */
export function toSign({ sending, number, checksum }: Part): PartToSign {
  return { upload_id: sending.upload.id, number, checksum };
}

export class Sending {
  /** When its lease was renewed, in milliseconds since 1970. */
  renewedMs: number;
  latest: PartToSign | null = null;
  ended = false;
  private left = 1; // the hashing itself; parts are added while it runs
  private readonly held: ReadonlyMap<number, StoredPart>;

  constructor(
    readonly planned: PlannedFile,
    readonly upload: UploadRead,
    private readonly remembered: ReadonlyMap<number, JournalPart>,
    /** The checksums of the whole, where it has been read already. */
    public sums: WholeSums | null,
    nowMs: number,
  ) {
    this.renewedMs = nowMs;
    this.held = new Map(upload.parts.map((part) => [part.number, part]));
  }

  get path(): string {
    return this.planned.path;
  }

  /** Yield number, offset and size of every part; a file of no bytes has one part of none. */
  *ranges(): Generator<readonly [number, number, number]> {
    const size = this.planned.identity.sizeBytes;
    const step = this.upload.part_size_bytes;
    for (let number = 1, offset = 0; number === 1 || offset < size; number++, offset += step) {
      yield [number, offset, Math.min(step, size - offset)];
    }
  }

  /** Read a part, adding it to the whole file's checksums, and return its own. @throws FileFailure */
  async hashPart(hashing: Hashing, offset: number, sizeBytes: number, read: (bytes: number) => void): Promise<string> {
    const known = sizeBytes === this.planned.identity.sizeBytes ? this.knownChecksum() : null;
    if (known !== null) return known;
    const part = await hashing.beginPart(this.upload.checksum);
    for await (const bytes of slices(this.planned, offset, sizeBytes)) {
      if (this.sums === null) hashing.addToWhole(bytes);
      part.update(bytes);
      read(bytes.length);
    }
    return part.digest("hex");
  }

  private knownChecksum(): string | null {
    if (this.sums === null) return null;
    const { checksum } = this.upload;
    if (checksum === "md5") return null;
    return checksum === "sha256" ? this.sums.sha256 : this.sums.crc64nvme;
  }

  /** Say whether the store holds these very bytes: our journal's checksum and the store's etag both agree. */
  isHeld(number: number, sizeBytes: number, checksum: string): boolean {
    const held = this.held.get(number);
    const written = this.remembered.get(number);
    if (held === undefined || written === undefined) return false;
    const sameEtag = held.etag.replaceAll('"', "") === written.etag;
    return sameEtag && held.size_bytes === sizeBytes && written.checksum === checksum;
  }

  addPart(): void {
    this.left += 1;
  }

  /** Count one part (or the hashing) as done; return true for the last of all. */
  partDone(): boolean {
    this.left -= 1;
    return this.left === 0;
  }

  /** Return what completes the upload, once all of it was read. */
  toFinish(): UploadFinish {
    if (this.sums === null) throw new Error(`${this.path} has not been read to its end`);
    return { upload_id: this.upload.id, sha256: this.sums.sha256, crc64nvme: this.sums.crc64nvme };
  }

  /** End this upload; return false when it had ended already. */
  end(): boolean {
    const first = !this.ended;
    this.ended = true;
    return first;
  }
}
