// Streaming checksums in WebAssembly: SHA-256 and CRC-64/NVME of whole files, and of each part the kind that the store
// verifies. Lower-case hexadecimal, as the API expects.
//
// Source: CRC-64/NVME is that of the NVM Express NVM Command Set Specification, section 5.2.1.3.4; the polynomial is
// 0xad93d23594c93659, here with its bits reversed.

import { createCRC64, createMD5, createSHA256, type IHasher } from "hash-wasm";
import type { ChecksumKind } from "./types";

const NVME_REVERSED = "9a6c9329ac4bc9b5";

/** Both checksums of a whole file. */
export interface WholeSums {
  readonly sha256: string;
  readonly crc64nvme: string;
}

export async function newChecksum(kind: ChecksumKind): Promise<IHasher> {
  if (kind === "crc64nvme") return createCRC64(NVME_REVERSED);
  return kind === "sha256" ? createSHA256() : createMD5();
}

/** Hashes one file at a time. */
export class Hashing {
  private readonly parts = new Map<ChecksumKind, IHasher>();

  private constructor(
    private readonly sha256: IHasher,
    private readonly crc64nvme: IHasher,
  ) {}

  static async ready(): Promise<Hashing> {
    return new Hashing(await newChecksum("sha256"), await newChecksum("crc64nvme"));
  }

  beginWhole(): void {
    this.sha256.init();
    this.crc64nvme.init();
  }

  addToWhole(bytes: Uint8Array): void {
    this.sha256.update(bytes);
    this.crc64nvme.update(bytes);
  }

  endWhole(): WholeSums {
    return { sha256: this.sha256.digest("hex"), crc64nvme: this.crc64nvme.digest("hex") };
  }

  /** Return an empty checksum for the next part; the one before it must have ended. */
  async beginPart(kind: ChecksumKind): Promise<IHasher> {
    const hasher = this.parts.get(kind) ?? (await newChecksum(kind));
    this.parts.set(kind, hasher);
    return hasher.init();
  }
}
