// @vitest-environment node
import { createHash } from "node:crypto";
import { describe, expect, it, vi } from "vitest";
import { reasons, safePath, saveToFolder, zipOf, type Source, type Target } from "./save";
import { commandOf, isNested, targetsOf } from "./selection";
import type { Mission } from "@/api/types";

vi.hoisted(() => vi.stubGlobal("location", { origin: "http://localhost" })); // Node has none; its streams are a browser's

/** A folder as browsers give it: a file has its bytes only once its writer is closed. */
class Folder {
  readonly files = new Map<string, Blob>();
  readonly folders = new Map<string, Folder>();

  async getDirectoryHandle(name: string): Promise<Folder> {
    const folder = this.folders.get(name) ?? new Folder();
    this.folders.set(name, folder);
    return Promise.resolve(folder);
  }

  async getFileHandle(name: string, { create = false } = {}) {
    if (!this.files.has(name) && !create) throw new DOMException("none", "NotFoundError");
    if (!this.files.has(name)) this.files.set(name, new Blob());
    const parts: BlobPart[] = [];
    return Promise.resolve({
      getFile: async () => Promise.resolve(this.files.get(name)),
      createWritable: async () =>
        Promise.resolve({
          write: async (part: BlobPart) => Promise.resolve(void parts.push(part)),
          close: async () => Promise.resolve(void this.files.set(name, new Blob(parts))),
          abort: async () => Promise.resolve(),
        }),
    });
  }

  async removeEntry(name: string): Promise<void> {
    this.files.delete(name);
    return Promise.resolve();
  }

  get handle(): FileSystemDirectoryHandle {
    return this as unknown as FileSystemDirectoryHandle;
  }
}

const LARGE = new Uint8Array(9 * 2 ** 20).fill(7);

function storeOf(contents: Readonly<Record<string, Uint8Array<ArrayBuffer>>>, spoil: (id: string, range: string) => Response | null = () => null) {
  const requests: string[] = [];
  const source: Source = {
    linkOf: async ({ fileId }) =>
      Promise.resolve({ url: fileId, sha256: createHash("sha256").update(contents[fileId] ?? "").digest("hex") }),
    fetch: async (input, init) => {
      const id = input as string;
      const range = new Headers(init?.headers).get("Range") ?? "";
      requests.push(`${id} ${range}`);
      const [from = 0, to = 0] = range.replace("bytes=", "").split("-").map(Number);
      return Promise.resolve(spoil(id, range) ?? new Response(contents[id]?.slice(from, to + 1), { status: 206 }));
    },
  };
  const targets: Target[] = Object.entries(contents).map(([id, bytes]) => ({ fileId: id, path: id.split("/"), sizeBytes: bytes.length }));
  const progress = { signal: new AbortController().signal, onBytes: () => undefined };
  return { requests, source, targets, progress };
}

const text = (words: string) => new TextEncoder().encode(words);

describe("a download into a folder", () => {
  it("writes each file below its folders, by ranges, and skips what is there the next time", async () => {
    const folder = new Folder();
    const { requests, source, targets, progress } = storeOf({ "a/b.bag": LARGE, "c.txt": text("words"), "empty.txt": text("") });
    expect(await saveToFolder(folder.handle, targets, source, progress)).toEqual({ written: 3, skipped: 0, failures: [] });
    const written = await folder.folders.get("a")?.files.get("b.bag")?.arrayBuffer();
    expect(Buffer.from(written ?? new ArrayBuffer()).equals(LARGE)).toBe(true);
    expect(requests.filter((item) => item.startsWith("a/b.bag"))).toEqual(["a/b.bag bytes=0-8388607", "a/b.bag bytes=8388608-9437183"]);
    requests.length = 0;
    expect(await saveToFolder(folder.handle, targets, source, progress)).toMatchObject({ written: 0, skipped: 3 });
    expect(requests).toEqual([]);
  });

  it("replaces no other file of the same name, and names it", async () => {
    const folder = new Folder();
    folder.files.set("c.txt", new Blob(["other"]));
    const { source, targets, progress } = storeOf({ "c.txt": text("words"), "d.txt": text("more") });
    expect(await saveToFolder(folder.handle, targets, source, progress)).toEqual({
      written: 1, skipped: 0, failures: [{ path: "c.txt", reason: reasons.inTheWay }],
    });
    expect(await folder.files.get("c.txt")?.text()).toBe("other");
  });

  it("writes no file over another of the same download, and names it", async () => {
    const folder = new Folder();
    const { source, targets, progress } = storeOf({ "a_b.txt": text("words"), "A_b.txt": text("other"), "c.txt": text("") });
    const { written, failures } = await saveToFolder(folder.handle, targets, source, progress);
    expect([written, failures]).toEqual([2, [{ path: "A_b.txt", reason: reasons.sameName }]]);
    expect(await folder.files.get("a_b.txt")?.text()).toBe("words");
  });

  it("leaves no file whose bytes are wrong, and asks again where the store stumbles", async () => {
    const folder = new Folder();
    let stumbles = 2;
    const { source, targets, progress } = storeOf({ "c.txt": text("words"), "d.txt": text("other") }, (id) => {
      if (id === "c.txt") return new Response("wrong", { status: 206 });
      return stumbles-- > 0 ? new Response("", { status: 503 }) : null;
    });
    const { written, failures } = await saveToFolder(folder.handle, targets, source, progress);
    expect([written, failures]).toEqual([1, [{ path: "c.txt", reason: reasons.wrongBytes }]]);
    expect([...folder.files.keys()]).toEqual(["d.txt"]);
  });
});

describe("a zip", () => {
  it("holds every file whole", async () => {
    const { source, targets, progress } = storeOf({ "a/b.bag": LARGE, "c.txt": text("words") });
    const zip = await zipOf(targets, source, progress);
    expect(zip.size).toBeGreaterThan(LARGE.length);
    const bytes = Buffer.from(await zip.arrayBuffer());
    expect([bytes.includes("a/b.bag"), bytes.includes("words"), bytes.subarray(0, 2).toString()]).toEqual([true, true, "PK"]);
  });

  it("is not made where two files have one path", async () => {
    const { source, targets, progress } = storeOf({ "c.txt": text("words") });
    await expect(zipOf([...targets, ...targets], source, progress)).rejects.toThrow(reasons.sameName);
  });

  it("that somebody stops has not failed", async () => {
    const controller = new AbortController();
    const { source, targets } = storeOf({ "a/b.bag": LARGE });
    const progress = { signal: controller.signal, onBytes: () => controller.abort() };
    const stopping: Source = { ...source, fetch: async (input, init) => { init?.signal?.throwIfAborted(); return source.fetch(input, init); } };
    await expect(zipOf(targets, stopping, progress)).rejects.toThrow(expect.objectContaining({ name: "AbortError" }) as Error);
  });

  it("is not made where a file is wrong, and names it", async () => {
    const { source, targets, progress } = storeOf({ "c.txt": text("words") }, () => new Response("wrong", { status: 206 }));
    await expect(zipOf(targets, source, progress)).rejects.toThrow("c.txt");
  });
});

describe("what is downloaded", () => {
  const alps = { id: "m1", name: "Day 1", project: { name: "Alps" } };
  const lake = { id: "m2", name: "Day*", project: { name: "Lake" } };
  const file = (path: string, mission: typeof alps) => ({ id: `id-${path}`, path, size_bytes: 1, mission });

  it("gets paths that every file system takes", () => {
    expect(safePath("../a//b:c/d?.")).toEqual(["a", "b_c", "d__"]);
    expect(targetsOf([file("x/y", alps)], true)[0]?.path).toEqual(["Alps", "Day 1", "x", "y"]);
  });

  it("has a command that does exactly the same", () => {
    expect(commandOf({ kind: "files", files: [file("a b.bag", alps), file("-x", alps)] })).toBe("klein download 'a b.bag' id--x -p Alps -m 'Day 1'");
    const missions = [alps, lake] as unknown as Mission[];
    expect(isNested({ kind: "missions", missions })).toBe(true);
    expect(commandOf({ kind: "missions", missions })).toBe(
      "klein download --nested --dest data -p Alps -m 'Day 1'\nklein download --nested --dest data -m m2",
    );
    expect(commandOf({ kind: "query", query: "it's $(rm)" })).toBe("klein download --nested --query 'it'\\''s $(rm)' --dest data");
  });
});
