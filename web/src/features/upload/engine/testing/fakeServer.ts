// An in-memory server and store that implement the upload protocol with its checks, and can be unreachable, slow, or
// respond with errors. Browser tests use the real ones.
import type { Answer, UploadApi } from "../api";
import { newChecksum } from "../checksums";
import type { Clock } from "../flow";
import type { ChecksumKind, PartToSign, ProblemDocument, SignedPart, UploadDecision, UploadFile, UploadFinish, UploadOutcome } from "../types";
import type { PutAnswer, Store } from "../store";

const LEASE_MS = 60_000;
const URL_MS = 900_000;

interface Upload {
  readonly id: string;
  readonly path: string;
  readonly sizeBytes: number;
  readonly parts: Map<number, Uint8Array>;
  open: boolean;
  leaseMs: number;
}

export function problem(code: ProblemDocument["code"], status: number, more: Record<string, unknown> = {}): ProblemDocument {
  return { code, status, title: code, detail: code, type: `urn:kleinkram:error:${code}`, request_id: "r1", ...more };
}

export async function sum(kind: ChecksumKind, bytes: Uint8Array): Promise<string> {
  return (await newChecksum(kind)).init().update(bytes).digest("hex");
}

export class FakeServer implements UploadApi, Store {
  checksum: ChecksumKind = "crc64nvme";
  partBytes = 1000;
  /** Files that are storedBytes, by path. */
  readonly files = new Map<string, Uint8Array>();
  readonly announced: UploadFile[] = [];
  readonly puts: string[] = [];
  readonly aborted: string[] = [];
  /** The next fault; consulted before each request and PUT. */
  fault: (what: "begin" | "sign" | "complete" | "abort" | "put") => Answer<never> | PutAnswer | "fine" = () => "fine";
  private readonly uploads = new Map<string, Upload>();
  private count = 0;

  constructor(public clock: Clock) {}

  get openUploads(): Upload[] {
    return [...this.uploads.values()].filter((upload) => upload.open);
  }

  /** Another client begins an upload of a name. */
  lease(path: string): Upload {
    const upload = { id: `other-${path}`, path, sizeBytes: 1, parts: new Map(), open: true, leaseMs: this.clock.now() + LEASE_MS };
    this.uploads.set(upload.id, upload);
    return upload;
  }

  /** End an upload behind its client's back. */
  lose(path: string): void {
    for (const upload of this.openUploads) if (upload.path === path) upload.open = false;
  }

  async begin(_missionId: string, files: readonly UploadFile[]): Promise<Answer<readonly UploadDecision[]>> {
    const wrong = this.fault("begin");
    if (wrong !== "fine") return wrong as Answer<never>;
    this.announced.push(...files);
    return { ok: await Promise.all(files.map((file) => this.decide(file))) };
  }

  private async decide(file: UploadFile): Promise<UploadDecision> {
    const { path, sha256 } = file;
    const storedBytes = this.files.get(path);
    const refused = (why: ProblemDocument): UploadDecision => ({ decision: "refused", path, problem: why });
    if (storedBytes !== undefined) {
      if (sha256 == null) return { decision: "hash_required", path };
      const existing = await sum("sha256", storedBytes);
      if (existing === sha256) return { decision: "already_present", file: null };
      return refused(problem("file_exists", 409, { path, existing_sha256: existing, sent_sha256: sha256 }));
    }
    const active = this.openUploads.find((upload) => upload.path === path);
    if (active !== undefined && active.id === file.upload_id) return this.send(active);
    if (active !== undefined && active.leaseMs > this.clock.now()) {
      return refused(problem("name_leased", 409, { path, lease_ends_at: new Date(active.leaseMs).toISOString() }));
    }
    if (active !== undefined) active.open = false;
    const id = `upload-${++this.count}`;
    const upload = { id, path, sizeBytes: file.size_bytes, parts: new Map(), open: true, leaseMs: 0 };
    this.uploads.set(id, upload);
    return this.send(upload);
  }

  private send(upload: Upload): UploadDecision {
    upload.leaseMs = this.clock.now() + LEASE_MS;
    const isMultipart = upload.sizeBytes > this.partBytes;
    const storedParts = [...upload.parts].map(([number, bytes]) => ({ number, size_bytes: bytes.length, etag: `"etag-${upload.id}-${number}"` }));
    return {
      decision: "upload",
      upload: {
        id: upload.id, mission_id: "m", path: upload.path, size_bytes: upload.sizeBytes, part_size_bytes: this.partBytes,
        checksum: this.checksum, state: "open", lease_ends_at: new Date(upload.leaseMs).toISOString(),
        expires_at: new Date(this.clock.now() + 1e9).toISOString(), parts: isMultipart ? storedParts : [],
      },
    };
  }

  sign(parts: readonly PartToSign[]): Promise<Answer<readonly SignedPart[]>> {
    const wrong = this.fault("sign");
    if (wrong !== "fine") return Promise.resolve(wrong as Answer<never>);
    const signed: SignedPart[] = [];
    for (const { upload_id, number, checksum } of parts) {
      const upload = this.uploads.get(upload_id);
      if (upload?.open !== true) return Promise.resolve({ problem: problem("upload_gone", 410, { upload_id }) });
      upload.leaseMs = this.clock.now() + LEASE_MS;
      const expires_at = new Date(this.clock.now() + URL_MS).toISOString();
      signed.push({ upload_id, number, url: `${upload_id}/${number}`, headers: { checksum }, expires_at });
    }
    return Promise.resolve({ ok: signed });
  }

  async put(part: SignedPart, body: Blob, signal: AbortSignal, moved: (sizeBytes: number) => void): Promise<PutAnswer> {
    const answer = (meaning: PutAnswer["meaning"], etag = "", reason = ""): PutAnswer => ({ meaning, etag, reason });
    if (signal.aborted) return answer("called_back");
    const wrong = this.fault("put");
    this.puts.push(part.url);
    if (wrong !== "fine") return wrong as PutAnswer;
    if (Date.parse(part.expires_at) <= this.clock.now()) return answer("sign_again", "", "403");
    const bytes = new Uint8Array(await body.arrayBuffer().catch(() => new ArrayBuffer(0)));
    if ((await sum(this.checksum, bytes)) !== part.headers["checksum"]) return answer("refused", "", "400 BadDigest");
    moved(bytes.length);
    this.uploads.get(part.upload_id)?.parts.set(part.number, bytes);
    return answer("taken", `etag-${part.upload_id}-${part.number}`);
  }

  async complete(finishes: readonly UploadFinish[]): Promise<Answer<readonly UploadOutcome[]>> {
    const wrong = this.fault("complete");
    if (wrong !== "fine") return wrong as Answer<never>;
    return { ok: await Promise.all(finishes.map((finish) => this.finish(finish))) };
  }

  private async finish({ upload_id, sha256, crc64nvme }: UploadFinish): Promise<UploadOutcome> {
    const upload = this.uploads.get(upload_id);
    const refused = (why: ProblemDocument): UploadOutcome => ({ outcome: "refused", upload_id, problem: why });
    if (upload?.open !== true) return refused(problem("upload_gone", 410));
    const parts = [...upload.parts].sort(([one], [other]) => one - other).map(([, bytes]) => bytes);
    const whole = new Uint8Array(await new Blob(parts as BlobPart[]).arrayBuffer());
    if (whole.length !== upload.sizeBytes) return refused(problem("upload_incomplete", 409));
    if ((await sum("sha256", whole)) !== sha256 || (await sum("crc64nvme", whole)) !== crc64nvme) {
      upload.open = false;
      return refused(problem("checksum_mismatch", 422));
    }
    upload.open = false;
    this.files.set(upload.path, whole);
    return { outcome: "completed", upload_id, file: null };
  }

  abort(uploadId: string): Promise<Answer<null>> {
    this.aborted.push(uploadId);
    const upload = this.uploads.get(uploadId);
    if (upload !== undefined) upload.open = false;
    return Promise.resolve({ ok: null });
  }
}

interface Waiter {
  readonly atMs: number;
  readonly wake: () => void;
}

export class FastClock implements Clock {
  private nowMs = Date.UTC(2026, 0, 1);
  private waiters: Waiter[] = [];
  private isPumping = false;
  private isFrozen = false;

  now(): number {
    return this.nowMs;
  }

  pass(milliseconds: number): void {
    this.nowMs += milliseconds;
  }

  async wait(milliseconds: number, signal: AbortSignal): Promise<void> {
    if (signal.aborted) return;
    await new Promise<void>((resolve) => {
      const wake = () => {
        signal.removeEventListener("abort", wake);
        this.waiters = this.waiters.filter((item) => item !== waiter);
        resolve();
      };
      const waiter = { atMs: this.nowMs + milliseconds, wake };
      this.waiters.push(waiter);
      signal.addEventListener("abort", wake);
      this.pump();
    });
  }

  /** Waits never end: the page was closed. */
  freeze(): void {
    this.isFrozen = true;
  }

  private pump(): void {
    if (this.isPumping || this.isFrozen) return;
    this.isPumping = true;
    setImmediate(() => {
      this.isPumping = false;
      const [first, ...rest] = this.waiters;
      if (first === undefined || this.isFrozen) return;
      const next = rest.reduce((one, other) => (other.atMs < one.atMs ? other : one), first);
      this.nowMs = Math.max(this.nowMs, next.atMs);
      next.wake();
      this.pump();
    });
  }
}
