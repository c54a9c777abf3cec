import { afterEach, beforeEach, describe, expect, it, test, vi } from "vitest";
import { layoutFor, openDraft } from "./draft";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

/** A file as a browser hands it over; one as new as this is watched for a second before it is taken. */
function chosen(path: string, lastModified = Date.now()): File {
  const file = new File(["x"], path.split("/").at(-1) ?? path, { lastModified });
  return Object.defineProperty(file, "webkitRelativePath", { value: path.includes("/") ? path : "" });
}

describe("what is chosen", () => {
  it("is gone for good once it was taken away, though it was still being looked at", async () => {
    const draft = openDraft();
    const taking = draft.take([chosen("day1/a.bag")]);
    draft.clear();
    await vi.runAllTimersAsync();
    await taking;
    expect([draft.plan, draft.isLooking]).toEqual([null, false]);
  });

  it("is what was chosen last, whichever is planned first", async () => {
    const draft = openDraft();
    const first = draft.take([chosen("day1/a.bag")]);
    await draft.take([chosen("b.bag", 1)]);
    await vi.runAllTimersAsync();
    await first;
    expect(draft.plan?.files.map(({ path }) => path)).toEqual(["b.bag"]);
  });

  it("says that it is being laid out anew until it is", async () => {
    const draft = openDraft();
    await Promise.all([draft.take([chosen("day1/a.bag")]), vi.runAllTimersAsync()]);
    const arranged = draft.arrange("contents");
    expect([draft.isLooking, draft.plan?.files[0]?.path]).toEqual([true, "day1/a.bag"]);
    await Promise.all([arranged, vi.runAllTimersAsync()]);
    expect([draft.isLooking, draft.plan?.files[0]?.path]).toEqual([false, "a.bag"]);
  });

  it("has the layout that it began with, also after it was taken away", () => {
    const draft = openDraft("contents");
    draft.clear();
    expect(draft.layout).toBe("contents");
  });
});

test("a folder goes on under the paths under which it was begun", () => {
  const chosen = ["day/drive.mcap", "day/cam/1.jpg"];
  expect(layoutFor(chosen, new Set(["cam/1.jpg"]))).toBe("contents");
  expect(layoutFor(chosen, new Set(["day/drive.mcap", "cam/1.jpg"]))).toBe("tree");
  expect(layoutFor(chosen, new Set(["other.bag"]))).toBe("tree");
  expect(layoutFor(chosen, new Set())).toBe("tree");
});

test("files without a folder stay as they are", () => {
  expect(layoutFor(["drive.mcap"], new Set(["drive.mcap"]))).toBe("tree");
});
