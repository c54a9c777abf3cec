// @vitest-environment node
import { beforeEach, describe, expect, it, vi } from "vitest";
import { UploadQueue, type Report } from "./uploadQueue";
import { MemoryJournal, type JournalHead } from "./journal";
import type { FileProgress, PlannedFile, WaitReason } from "./types";
import { identityOf } from "./plan";
import { FastClock, FakeServer, problem, sum } from "./testing/fakeServer";

const HEAD: JournalHead = {
  id: "ada/m", personId: "ada", layout: "tree", roots: ["day1"], beganMs: 0,
  mission: { id: "m", name: "M", projectId: "p", projectName: "P" },
};
vi.setConfig({ testTimeout: 30_000 }); // they hash megabytes, maybe on a machine that has much else to do

const LARGE = 9 * 1024 * 1024;

let clock: FastClock;
let server: FakeServer;
let journal: MemoryJournal;
let reports: Report[];

beforeEach(() => {
  clock = new FastClock();
  server = new FakeServer(clock);
  journal = new MemoryJournal();
  reports = [];
});

function bytesOf(sizeBytes: number, seed = 1): Uint8Array {
  const bytes = new Uint8Array(sizeBytes);
  for (let place = 0; place < sizeBytes; place++) bytes[place] = place * 31 + seed * (place >> 8) + seed;
  return bytes;
}

function planned(path: string, bytes: Uint8Array, modifiedMs = 1000): PlannedFile {
  const file = new File([bytes as BlobPart], path.split("/").at(-1) ?? path, { lastModified: modifiedMs });
  return { path, file, identity: identityOf(file) };
}

function queue(on: (report: Report, queue: UploadQueue) => void = () => undefined): UploadQueue {
  const received = reports;
  const report = (isCalled: Report) => {
    received.push(isCalled);
    on(isCalled, made);
  };
  const alone = async (_: string, run: () => Promise<void>) => (await run(), true);
  const made = new UploadQueue({ api: server, store: server, journal, clock, report, alone });
  return made;
}

function arrived(path: string, bytes: Uint8Array): void {
  expect(Buffer.from(server.files.get(path) ?? []).equals(bytes), `${path} arrived whole`).toBe(true);
}

function ends(): Map<string, FileProgress> {
  return new Map(reports.flatMap(({ snapshot }) => snapshot.changed.map((file) => [file.path, file] as const)));
}

function last(): Report {
  return reports.at(-1) as Report;
}

function waitReasons(): Set<WaitReason> {
  return new Set(reports.flatMap(({ snapshot }) => [...snapshot.waitReasons]));
}

describe("an upload", () => {
  it("brings every byte, in one part or many or none, and leaves no journal", async () => {
    const all = [planned("day1/a", bytesOf(3500)), planned("day1/b", bytesOf(10)), planned("day1/empty", bytesOf(0))];
    await queue().start(HEAD, all);
    for (const { path, file } of all) arrived(path, new Uint8Array(await file.arrayBuffer()));
    expect(last()).toMatchObject({ phase: "over", snapshot: { doneBytes: 3510, totalBytes: 3510 } });
    expect([...ends().values()].map(({ state }) => state)).toEqual(["uploaded", "uploaded", "uploaded"]);
    expect(await journal.heads("ada")).toEqual([]);
    expect(await journal.files(HEAD.id)).toEqual([]);
  });

  it("reads a large file once, and states both checksums of the whole", async () => {
    server.partBytes = 4 * 1024 * 1024;
    const large = bytesOf(LARGE);
    await queue().start(HEAD, [planned("large", large)]);
    expect(server.announced).toMatchObject([{ path: "large", sha256: null }]);
    expect(server.puts).toHaveLength(3);
    arrived("large", large);
  });

  it.each(["sha256", "md5"] as const)("goes to stores that verify parts by %s", async (kind) => {
    server.checksum = kind;
    await queue().start(HEAD, [planned("a", bytesOf(2500)), planned("b", bytesOf(7))]);
    expect([...server.files.keys()].sort()).toEqual(["a", "b"]);
  });

  it("sends nothing that is there already, and says so", async () => {
    server.files.set("a", bytesOf(50));
    await queue().start(HEAD, [planned("a", bytesOf(50))]);
    expect(server.puts).toEqual([]);
    expect(ends().get("a")?.state).toBe("already_present");
  });

  it("reads a large file first where the server asks for its checksum", async () => {
    server.files.set("a", bytesOf(LARGE));
    await queue().start(HEAD, [planned("a", bytesOf(LARGE))]);
    expect(server.announced.map(({ sha256 }) => sha256 != null)).toEqual([false, true]);
    expect(ends().get("a")?.state).toBe("already_present");
  });

  it("refuses a name with other content, with both hashes, and brings the others", async () => {
    server.files.set("a", bytesOf(50, 2));
    await queue().start(HEAD, [planned("a", bytesOf(50)), planned("b", bytesOf(60))]);
    const failure = ends().get("a")?.failure;
    const [theirs, ours] = [await sum("sha256", bytesOf(50, 2)), await sum("sha256", bytesOf(50))];
    expect(failure).toMatchObject({ problem: { code: "file_exists", existing_sha256: theirs, sent_sha256: ours } });
    expect(server.files.has("b")).toBe(true);
    expect(last().snapshot).toMatchObject({ doneBytes: 60, totalBytes: 60 });
    expect(await journal.heads("ada")).toEqual([]);
  });

  it("refuses what has no room, and keeps it for another day", async () => {
    server.fault = (what) => (what === "begin" ? { problem: problem("quota_exceeded", 507) } : "fine");
    await queue().start(HEAD, [planned("a", bytesOf(50))]);
    expect(ends().get("a")?.failure).toMatchObject({ problem: { code: "quota_exceeded" } });
    expect(await journal.files(HEAD.id)).toMatchObject([{ path: "a", state: "waiting" }]);
  });

  it("refuses a file that was written to while it was read, and frees its name", async () => {
    const changed = planned("a", bytesOf(LARGE));
    server.partBytes = 1024 * 1024;
    const slice = changed.file.slice.bind(changed.file);
    changed.file.slice = (from = 0, to = 0) =>
      from < 5_000_000 ? slice(from, to) : ({ arrayBuffer: () => Promise.reject(new DOMException("", "NotReadableError")) } as Blob);
    await queue().start(HEAD, [changed, planned("b", bytesOf(9))]);
    expect(ends().get("a")?.failure).toMatchObject({ kind: "file_changed" });
    expect(server.aborted).toEqual(["upload-1"]);
    expect(server.openUploads).toEqual([]);
    expect(server.files.has("b")).toBe(true);
  });

  it("stops at what concerns all files, and keeps what was sent", async () => {
    server.fault = (what) => (what === "complete" ? { problem: problem("internal_error", 500) } : "fine");
    server.partBytes = 1_000_000;
    await queue().start(HEAD, [planned("a", bytesOf(LARGE))]);
    expect(last()).toMatchObject({ phase: "failed", failure: { problem: { code: "internal_error", request_id: "r1" } } });
    expect(ends().get("a")?.state).toBe("left");
    expect(await journal.files(HEAD.id)).toMatchObject([{ state: "sending" }]);
  });
});

describe("after a reload", () => {
  const whole = bytesOf(LARGE);

  async function interrupted(parts: number): Promise<void> {
    server.partBytes = 1_000_000;
    server.fault = (what) => {
      if (what !== "put") return "fine";
      if (server.puts.length < parts) return "fine";
      return { meaning: "try_again", etag: "", reason: "" };
    };
    const first = queue(({ phase, snapshot }, at) => {
      if (phase === "running" && snapshot.waitReasons.includes("store")) at.pause(HEAD.id); // as a page that is closed: it does nothing more
    });
    void first.start(HEAD, [planned("a", whole), planned("b", bytesOf(5))]);
    await expect.poll(() => last().phase, { timeout: 20_000 }).toBe("paused");
    clock.freeze();
    clock = new FastClock();
    server.clock = clock;
    server.fault = () => "fine";
    server.puts.length = 0;
    reports = [];
  }

  it("sends only the parts that the store does not hold", async () => {
    await interrupted(4);
    await queue().start(HEAD, [planned("a", whole), planned("b", bytesOf(5))]);
    arrived("a", whole);
    expect(server.puts.filter((url) => url.startsWith("upload-1/"))).toHaveLength(10 - 4);
  });

  it("sends again each part whose bytes are other ones now", async () => {
    await interrupted(4);
    const other = whole.slice();
    other[10] = 99;
    await queue().start(HEAD, [planned("a", other, 2000), planned("b", bytesOf(5))]);
    arrived("a", other);
    expect(server.puts.filter((url) => url.startsWith("upload-1/"))).toHaveLength(10 - 3);
  });

  it("begins a file anew that has another size now", async () => {
    await interrupted(4);
    await queue().start(HEAD, [planned("a", bytesOf(LARGE + 1), 2000)]);
    expect(server.aborted).toEqual(["upload-1"]);
    arrived("a", bytesOf(LARGE + 1));
  });

  it("does not read again what had come in and is the same file still", async () => {
    await interrupted(4);
    await journal.note([{ id: HEAD.id, path: "b", sizeBytes: 5, modifiedMs: 1000, state: "done", uploadId: null, sha256: await sum("sha256", bytesOf(5)) }]);
    server.files.set("b", bytesOf(5));
    const unread = planned("b", bytesOf(5));
    unread.file.slice = () => { throw new Error("it is read"); };
    await queue().start(HEAD, [planned("a", whole), unread]);
    expect(ends().get("b")?.state).toBe("already_present");
  });
});

describe("trouble", () => {
  it("waits for a server that is away, says so, and goes on", async () => {
    let tries = 0;
    server.fault = (what) => (what === "begin" && ++tries < 9 ? null : "fine");
    await queue().start(HEAD, [planned("a", bytesOf(5))]);
    expect(tries).toBe(9);
    expect(waitReasons()).toEqual(new Set(["server"]));
    expect(last().snapshot.waitReasons).toEqual([]);
    expect(server.files.has("a")).toBe(true);
  });

  it("waits for a store that is away, whatever the server says of it", async () => {
    let tries = 0;
    server.fault = (what) => {
      if (what === "put" && ++tries < 6) return { meaning: "try_again", etag: "", reason: "" };
      return what === "complete" && ++tries < 12 ? { problem: problem("store_unavailable", 503) } : "fine";
    };
    await queue().start(HEAD, [planned("a", bytesOf(5))]);
    expect(last()).toMatchObject({ phase: "over", snapshot: { doneBytes: 5, totalBytes: 5 } });
    expect(waitReasons()).toEqual(new Set(["store", "server"]));
  });

  it("waits as long as a server says that is asked too often", async () => {
    let isCalled = false;
    server.fault = (what) => {
      if (what !== "begin" || isCalled) return "fine";
      isCalled = true;
      return { problem: problem("rate_limited", 429, { retry_after_s: 40 }) };
    };
    const before = clock.now();
    await queue().start(HEAD, [planned("a", bytesOf(5))]);
    expect(clock.now() - before).toBeGreaterThanOrEqual(40_000);
    expect(server.files.has("a")).toBe(true);
  });

  it("has an address signed again that is no longer good", async () => {
    const sign = server.sign.bind(server);
    let late = true;
    server.sign = async (parts) => {
      const signed = await sign(parts);
      if (late) clock.pass(16 * 60_000);
      late = false;
      return signed;
    };
    await queue().start(HEAD, [planned("a", bytesOf(5))]);
    expect(server.puts).toHaveLength(1);
    expect(server.files.has("a")).toBe(true);
  });

  it("gives up a part that the store refuses again and again", async () => {
    server.fault = (what) => (what === "put" ? { meaning: "refused", etag: "", reason: "400 BadDigest" } : "fine");
    await queue().start(HEAD, [planned("a", bytesOf(5))]);
    expect(server.puts).toHaveLength(4);
    expect(ends().get("a")?.failure).toEqual({ kind: "transfer_failed", detail: "400 BadDigest" });
  });

  it("begins a file anew whose upload has ended behind its back", async () => {
    let lost = false;
    server.fault = (what) => {
      if (what === "complete" && !lost) {
        lost = true;
        server.lose("a");
      }
      return "fine";
    };
    await queue().start(HEAD, [planned("a", bytesOf(2500)), planned("b", bytesOf(5))]);
    arrived("a", bytesOf(2500));
    expect(last().snapshot).toMatchObject({ doneBytes: 2505, totalBytes: 2505 });
  });

  it("keeps its names while a store is away for minutes", async () => {
    const until = clock.now() + 5 * 60_000;
    const leases: number[] = [];
    server.fault = (what) => {
      if (what !== "put" || clock.now() > until) return "fine";
      leases.push(...server.openUploads.map((upload) => upload.leaseMs - clock.now()));
      return { meaning: "try_again", etag: "", reason: "" };
    };
    await queue().start(HEAD, [planned("a", bytesOf(2500))]);
    expect(Math.min(...leases)).toBeGreaterThan(0);
    expect(server.files.has("a")).toBe(true);
  });

  it("waits for a name whose holder has died, and refuses one whose holder lives", async () => {
    server.lease("dead");
    const alive = server.lease("alive");
    server.fault = (what) => {
      if (what === "begin" && server.announced.length > 0) alive.leaseMs = clock.now() + 60_000;
      return "fine";
    };
    await queue().start(HEAD, [planned("dead", bytesOf(5)), planned("alive", bytesOf(5))]);
    expect(server.files.has("dead")).toBe(true);
    expect(ends().get("alive")?.failure).toMatchObject({ problem: { code: "name_leased" } });
    expect(waitReasons()).toContain("lease");
  });
});

describe("a person", () => {
  it("pauses, when nothing is sent, and goes on", async () => {
    server.partBytes = 1_000_000;
    let atPause = -1;
    const at = queue();
    server.fault = (what) => {
      if (what === "put" && server.puts.length === 3 && atPause < 0) {
        at.pause(HEAD.id);
        atPause = server.puts.length;
        void clock.wait(300_000, new AbortController().signal).then(() => {
          expect(server.puts.length - atPause).toBeLessThanOrEqual(4);
          at.resume(HEAD.id);
        });
      }
      return "fine";
    };
    await at.start(HEAD, [planned("a", bytesOf(LARGE))]);
    expect(reports.some(({ phase }) => phase === "paused")).toBe(true);
    arrived("a", bytesOf(LARGE));
  });

  it("signs in again and the upload goes on where it was", async () => {
    let isSignedIn = true;
    server.partBytes = 1_000_000;
    server.fault = (what) => {
      if (server.puts.length === 2 && what === "put") isSignedIn = false;
      return what !== "put" && !isSignedIn ? { problem: problem("not_authenticated", 401) } : "fine";
    };
    const at = queue(({ phase }) => {
      if (phase !== "signed_out" || isSignedIn) return;
      server.fault = () => "fine";
      isSignedIn = true;
      queueMicrotask(() => at.resume(HEAD.id));
    });
    await at.start(HEAD, [planned("a", bytesOf(LARGE))]);
    expect(reports.some(({ phase }) => phase === "signed_out")).toBe(true);
    arrived("a", bytesOf(LARGE));
  });

  it("cancels: what came in stays, names are free, and nothing is remembered", async () => {
    server.partBytes = 1_000_000;
    const at = queue();
    server.fault = (what) => {
      if (what === "put" && server.puts.length === 3) at.cancel(HEAD.id);
      return "fine";
    };
    await at.start(HEAD, [planned("a", bytesOf(5)), planned("b", bytesOf(LARGE))]);
    expect(last().phase).toBe("cancelled");
    expect(server.openUploads).toEqual([]);
    expect(ends().get("b")?.state).toBe("left");
    expect(await journal.heads("ada")).toEqual([]);
  });

  it("says that it failed where the browser has no room to remember it, and leaves all files to be tried again", async () => {
    journal.begin = () => Promise.reject(new DOMException("no room", "QuotaExceededError"));
    await queue().start(HEAD, [planned("a", bytesOf(5))]);
    expect(last()).toMatchObject({ phase: "failed", failure: { detail: "no room" } });
    expect(ends().get("a")?.state).toBe("left");
    expect(server.files.size).toBe(0);
  });

  it("adds files to an upload that runs: they come after it", async () => {
    const at = queue();
    await Promise.all([at.start(HEAD, [planned("a", bytesOf(5))]), at.start(HEAD, [planned("b", bytesOf(6))])]);
    expect([...server.files.keys()]).toEqual(["a", "b"]);
    expect(await journal.heads("ada")).toEqual([]);
  });
});
