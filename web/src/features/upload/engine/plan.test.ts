// @vitest-environment node
import { describe, expect, it } from "vitest";
import { chosen, entriesOf, walk } from "./reading";
import type { Found } from "./types";
import { checkFilePath, nameKey, planUpload } from "./plan";

const NOW = 1_000_000;
const watch = { now: () => NOW, wait: () => Promise.resolve() };

function foundFile(path: string, more: Partial<Found> & { readonly modified?: number; readonly size?: number } = {}): Found {
  const { modified = 0, size = 3, ...rest } = more;
  return { path, file: new File(["x".repeat(size)], path, { lastModified: modified }), ...rest };
}

const plan = (all: readonly Found[], layout: "tree" | "contents" = "tree") => planUpload(all, { layout, watch });

describe("a plan", () => {
  it("keeps the tree, in order, and knows recordings of several files", async () => {
    const planned = await plan([foundFile("d/run/run_0.db3"), foundFile("d/cam.mcap", { size: 5 }), foundFile("d/run/metadata.yaml"), foundFile("d/metadata.yaml.txt")]);
    expect(planned.files.map(({ path }) => path)).toEqual(["d/cam.mcap", "d/metadata.yaml.txt", "d/run/metadata.yaml", "d/run/run_0.db3"]);
    expect(planned.rosbag2Folders).toEqual(["d/run"]);
    expect(planned.sizeBytes).toBe(14);
  });

  it("leaves the folder's name away where one wants that", async () => {
    const planned = await plan([foundFile("day1/a.bag"), foundFile("day1/sub/b.bag")], "contents");
    expect(planned.files.map(({ path }) => path)).toEqual(["a.bag", "sub/b.bag"]);
  });

  it("lets the page breathe between many files whose sizes take long to ask for", async () => {
    let now = NOW;
    let yields = 0;
    const slow = { now: () => (now += 1), wait: (milliseconds: number) => Promise.resolve(void (yields += milliseconds === 0 ? 1 : 0)) };
    const planned = await planUpload(Array.from({ length: 100 }, (_, at) => foundFile(`d/${at}.bag`)), { layout: "tree", watch: slow });
    expect(planned.files).toHaveLength(100);
    expect(yields).toBeGreaterThanOrEqual(4);
  });

  it("leaves out what is still recorded, and says so", async () => {
    const grown = new File(["more"], "grown", { lastModified: NOW });
    const planned = await plan([
      foundFile("a.bag.active"),
      foundFile("growing.bag", { modified: NOW - 100, again: () => Promise.resolve(grown) }),
      foundFile("gone.bag", { modified: NOW - 100, again: () => Promise.reject(new DOMException("", "NotFoundError")) }),
      foundFile("fresh.bag", { modified: NOW - 100 }),
      foundFile("old.bag", { again: () => Promise.reject(new Error("nobody looks at this one again")) }),
    ]);
    expect(planned.files.map(({ path }) => path)).toEqual(["fresh.bag", "old.bag"]);
    expect(planned.leftOut.map(({ path, reason }) => [path, reason])).toEqual([["a.bag.active", "active"], ["growing.bag", "growing"], ["gone.bag", "growing"]]);
  });

  it("leaves out names that cannot be, and the second of two that are one", async () => {
    const planned = await plan([foundFile("a\u0007.bag"), foundFile("CAM.bag"), foundFile("cam.bag")]);
    expect(planned.files.map(({ path }) => path)).toEqual(["CAM.bag"]);
    expect(planned.leftOut).toEqual([
      { path: "a\u0007.bag", reason: "name", detail: "the name contains the control character U+0007; rename the file" },
      { path: "cam.bag", reason: "collides", detail: "CAM.bag" },
    ]);
  });
});

/** An entry of a dropped folder, as browsers hand it over: contents in portions, then none. */
function entry(fullPath: string, contents: readonly unknown[] | null): FileSystemEntry {
  let portions = contents === null ? [] : [contents.slice(0, 2), contents.slice(2)];
  const readEntries = (take: (some: readonly unknown[]) => void) => {
    const [first = [], ...rest] = portions.filter((some) => some.length > 0);
    portions = rest;
    take(first);
  };
  const file = (take: (file: File) => void, refuse: (error: Error) => void) => {
    if (fullPath.endsWith("locked")) refuse(new DOMException("", "NotReadableError"));
    else take(new File(["x"], fullPath));
  };
  return { fullPath, isDirectory: contents !== null, createReader: () => ({ readEntries }), file } as unknown as FileSystemEntry;
}

describe("what is dropped", () => {
  it("is walked through to its last folder; empty ones are nothing, what cannot be read is named", async () => {
    const inside = [entry("/d/a", null), entry("/d/empty", []), entry("/d/locked", null), entry("/d/sub", [entry("/d/sub/b", null)])];
    const { droppedFiles: all, unreadable } = await walk([entry("/d", inside), entry("/top", null)], () => undefined);
    expect(all.map(({ path }) => path).sort()).toEqual(["d/a", "d/sub/b", "top"]);
    expect(unreadable).toEqual(["d/locked"]);
  });

  it("is files alone, where it is no folder", () => {
    const items = [{ kind: "string", webkitGetAsEntry: () => null }, { kind: "file", webkitGetAsEntry: () => entry("/a", null) }];
    expect(entriesOf({ items } as unknown as DataTransfer)).toHaveLength(1);
    const files = ["", "day1/b.bag"].map((webkitRelativePath) => Object.assign(new File([], "a.bag"), { webkitRelativePath }));
    expect(chosen(files).map(({ path }) => path)).toEqual(["a.bag", "day1/b.bag"]);
  });
});

describe("a path in a mission", () => {
  it.each(["a", "day1/cam.mcap", "tänzerin/ärger.bag", "a b/c (1).bag", "x".repeat(255)])("may be %s", (path) => {
    expect(checkFilePath(path)).toBe(path);
  });

  it("is told in one Unicode form", () => {
    expect(checkFilePath("a\u0308.bag")).toBe("\u00e4.bag");
  });

  // The same as `contract/names.py` refuses.
  it.each([
    ["", "not_relative"],
    ["/a", "not_relative"],
    ["a/", "not_relative"],
    ["a\\b", "backslash"],
    ["a//b", "part"],
    ["a/../b", "part"],
    ["./a", "part"],
    ["a\u0007b", "control"],
    ["a\u202eb", "control"],
    ["a\ud800b", "control"],
    ["x".repeat(256), "long_part"],
    ["ä".repeat(128), "long_part"],
    [`${"y/".repeat(600)}z`, "too_long"],
    [`${"語".repeat(80)}/`.repeat(11) + "z", "too_many_bytes"],
  ])("may not be %j", (path, problem) => {
    expect(checkFilePath(path)).toMatchObject({ problem });
  });

  it("is the same in any case and form", () => {
    expect(nameKey("Straße/CAM.MCAP")).toBe(nameKey("STRASSE/cam.mcap"));
    expect(nameKey("a\u0308")).toBe(nameKey("\u00c4"));
  });
});
