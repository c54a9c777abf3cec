// The state of one file's upload (remaining parts, checksums), and sending a part with retries.
import type { Hashing, WholeSums } from "./checksums";
import type { Journal, JournalPart, StoredPart } from "./journal";
import type { PartToSign, PlannedFile, SignedPart, UploadFinish, UploadRead } from "./types";
import { checkUnchanged, slices } from "./reading";
import { ApiProblem, type RetryingApi, type UploadContext } from "./api";
import type { PutAnswer, Store } from "./store";
import type { Watcher } from "./progressStore";

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
  private readonly storedParts: ReadonlyMap<number, StoredPart>;

  constructor(
    readonly planned: PlannedFile,
    readonly upload: UploadRead,
    private readonly remembered: ReadonlyMap<number, JournalPart>,
    /** The checksums of the whole, where it has been read already. */
    public sums: WholeSums | null,
    nowMs: number,
  ) {
    this.renewedMs = nowMs;
    this.storedParts = new Map(upload.parts.map((part) => [part.number, part]));
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

  /** Return whether the store holds these very bytes: our journal's checksum and the store's etag both agree. */
  isStored(number: number, sizeBytes: number, checksum: string): boolean {
    const storedParts = this.storedParts.get(number);
    const written = this.remembered.get(number);
    if (storedParts === undefined || written === undefined) return false;
    const sameEtag = storedParts.etag.replaceAll('"', "") === written.etag;
    return sameEtag && storedParts.size_bytes === sizeBytes && written.checksum === checksum;
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

const REFUSALS = 4;

/** What an upload works with. */
export interface Parts {
  readonly retryingApi: RetryingApi;
  readonly store: Store;
  readonly journal: Journal;
  readonly hashing: Hashing;
  readonly watcher: Watcher;
  readonly context: UploadContext;
  readonly stop: AbortController;
}

/** The store would not take a part, for its own reason. */
export class StoreRefused extends Error {
  override readonly name = "StoreRefused";
}

/**
 * Send a part; resolves when the store has it and the journal contains it, or the upload has ended.
 *
 * @throws FileFailure, ApiProblem (of this upload, or of all), StoreRefused, Stopped
 */
export async function sendPart(part: Part, first: SignedPart, parts: Parts): Promise<void> {
  const { retryingApi, context } = parts;
  const signAgain = async () => (await retryingApi.sign([toSign(part)]))[0] as SignedPart;
  const tries = context.backoff.begin();
  let signed = first;
  let refusals = 0;
  while (!part.sending.ended) {
    await context.gate.passed();
    if (Date.parse(signed.expires_at) <= context.clock.now()) signed = await signAgain(); // spares sending it in vain
    const answer = await put(part, signed, parts);
    if (answer.meaning === "taken") {
      context.waitReasons.over("store");
      if (part.sizeBytes < part.sending.upload.size_bytes) {
        const { sending, number, checksum } = part;
        await parts.journal.record({ uploadId: sending.upload.id, number, checksum, etag: answer.etag });
      }
      return;
    }
    if (answer.meaning === "gone") throw goneAt(part);
    if (answer.meaning !== "called_back") await checkUnchanged(part.sending.planned);
    if (answer.meaning === "try_again") {
      context.waitReasons.note("store", context.clock.now());
      await tries.pause();
    } else if (answer.meaning !== "called_back" && ++refusals >= REFUSALS) {
      throw new StoreRefused(answer.reason);
    }
    signed = await signAgain();
  }
}

async function put(part: Part, signed: SignedPart, { store, context, watcher }: Parts): Promise<PutAnswer> {
  const { planned, path } = part.sending;
  const body = planned.file.slice(part.offset, part.offset + part.sizeBytes);
  let sent = 0;
  const answer = await store.put(signed, body, context.gate.called, (sizeBytes) => {
    sent += sizeBytes;
    watcher.moved(path, sizeBytes);
  });
  // The store confirms only the whole part; a small part may have caused no progress event.
  watcher.moved(path, answer.meaning === "taken" ? part.sizeBytes - sent : -sent);
  return answer;
}

function goneAt(part: Part): ApiProblem {
  const detail = `the store no longer knows the upload of ${part.sending.path}`;
  const code = "upload_gone";
  return new ApiProblem({ code, detail, status: 410, title: "upload gone", type: "urn:kleinkram:error:upload_gone" });
}
