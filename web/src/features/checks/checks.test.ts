import { describe, expect, it } from "vitest";
import { canBeAccepted, categories, failedCount, filtered, keyOf, measured, notesOf, worstFirst } from "./checks";
import { diffLines, folded } from "./diff";
import { positionOf, textErrorOf } from "./rules";
import { barsOf, cellAfter, columnsOf, MAX_BARS, worstOf } from "./matrix";
import type { Check, MatrixRow, Note } from "./queries";
import { Problem } from "@/api/problem";
import { countsText } from "@/texts/checks";

function check(name: string, status: Check["status"], more: Partial<Check> = {}): Check {
  return { name, status, message: `${name} is ${status}`, source: "server", ...more };
}

const gap = check("topic.gap", "error", { topic: "/imu", value: 2.5, limit: 1, unit: "s" });
const accepted = check("topic.rate", "error", { topic: "/lidar", acceptance_id: "a" });
const rate = check("topic.rate", "warning", { topic: "/imu" });
const black = check("image.black", "not_made", { topic: "/camera", source: "report" });
const fine = check("file.count", "ok");
const content = check("imu.gravity", "needs_content", { topic: "/imu" });
const all = [gap, accepted, rate, black, fine, content];
const names = (checks: readonly Check[]) => checks.map(({ name, topic }) => `${name} ${topic ?? ""}`.trim());

describe("checks of a mission", () => {
  it("are filtered by words in any order, status and source, accepted ones behind those that failed", () => {
    expect(names(filtered(all, { text: "", statuses: [], source: "" }))).toEqual([
      "topic.gap /imu", "topic.rate /imu", "image.black /camera", "topic.rate /lidar", "file.count", "imu.gravity /imu",
    ]);
    expect(names(filtered(all, { text: "/IMU topic", statuses: [], source: "" }))).toEqual(["topic.gap /imu", "topic.rate /imu"]);
    expect(names(filtered(all, { text: "", statuses: ["error"], source: "" }))).toEqual(["topic.gap /imu"]);
    expect(names(filtered(all, { text: "", statuses: ["error", "accepted"], source: "" }))).toEqual(["topic.gap /imu", "topic.rate /lidar"]);
    expect(names(filtered(all, { text: "", statuses: [], source: "report" }))).toEqual(["image.black /camera"]);
  });
  it("are counted by status, accepted ones apart", () => {
    expect(categories(all).map(({ category, count }) => `${category} ${count}`)).toEqual(["error 1", "warning 1", "not_made 1", "needs_content 1", "accepted 1", "ok 1"]);
    expect(categories([])).toEqual([]);
  });
  it("can be accepted where they failed or could not be made, once", () => {
    expect(all.filter(canBeAccepted)).toEqual([gap, rate, black]);
  });
  it("have different keys on different topics, files, and sources", () => {
    expect(new Set([...all, check("topic.rate", "ok", { topic: "/imu", source: "report" })].map(keyOf)).size).toBe(all.length + 1);
    expect(keyOf(rate)).toBe(keyOf({ ...rate, status: "ok", message: "made again" }));
  });
  it("have the notes on their topic, and those on all topics", () => {
    const note = (id: string, name: string, topic: string | null) => ({ id, check: name, topic, text: id, created_at: "", created_by: { id: "", name: "" } }) satisfies Note;
    const notes = [note("one", "topic.rate", "/imu"), note("all", "topic.rate", null), note("other", "topic.rate", "/lidar"), note("gap", "topic.gap", "/imu")];
    expect(notesOf(rate, notes).map(({ id }) => id)).toEqual(["one", "all"]);
  });
  it("of a run are listed worst first, else as they were reported", () => {
    const rows = [fine, content, rate, gap, black, accepted].map((one) => ({ check: one }));
    expect(worstFirst(rows).map((row) => row.check)).toEqual([gap, accepted, rate, black, content, fine]);
    expect(worstFirst([])).toEqual([]);
  });
  it("show values with their unit", () => {
    expect(measured(199.87654, "Hz")).toBe("199.88 Hz");
    expect(measured(123456.7, null)).toBe("123,457");
    expect(measured(0, "s")).toBe("0 s");
    expect(measured(1_703_900, "B")).toBe("1.7 MB");
    expect(measured(null, "s")).toBe("");
  });
  it("are summed in words, and only failed ones are counted as failed", () => {
    const counts = { error: 2, warning: 1, not_made: 1, ok: 1200, needs_content: 0, accepted: 1 };
    expect(countsText(counts)).toBe("2 errors, 1 warning, 1 not made, 1 accepted, 1,200 passed");
    expect(failedCount(counts)).toBe(4);
    expect(countsText({ error: 0, warning: 0, not_made: 0, ok: 0, needs_content: 0, accepted: 0 })).toBe("");
  });
});

const row = (columns: readonly string[]) => ({ names: columns }) as unknown as MatrixRow;

describe("the matrix", () => {
  it("has the columns of the first page first, then those that later pages add", () => {
    const [first, second] = [["topic.gap", "file.count"], ["file.count", "image.black"]];
    expect(columnsOf([row(first), row(first), row(second)])).toEqual(["topic.gap", "file.count", "image.black"]);
    expect(columnsOf([])).toEqual([]);
  });
  it("is walked by keys, and not left", () => {
    const at = { row: 5, column: 2 };
    const after = (key: string, control = false) => cellAfter(key, at, 20, 4, 10, control);
    expect(after("ArrowRight")).toEqual({ row: 5, column: 3 });
    expect(cellAfter("ArrowRight", { row: 5, column: 3 }, 20, 4, 10, false)).toEqual({ row: 5, column: 3 });
    expect(after("ArrowUp")).toEqual({ row: 4, column: 2 });
    expect(after("PageDown")).toEqual({ row: 15, column: 2 });
    expect(after("Home")).toEqual({ row: 5, column: 0 });
    expect(after("End", true)).toEqual({ row: 19, column: 3 });
    expect(after("a")).toBeNull();
    expect(cellAfter("ArrowDown", at, 0, 4, 10, false)).toBeNull();
  });
  it("explains a cell by the worst checks that count", () => {
    expect(worstOf(all, "topic.rate")).toEqual([rate]);
    expect(worstOf([accepted], "topic.rate")).toEqual([accepted]);
    expect(worstOf(all, "nothing")).toEqual([]);
  });
});

describe("the trend", () => {
  it("has a bar for weeks without missions, as tall as its share of the tallest", () => {
    const bars = barsOf({ by: "week", buckets: [{ start: "2026-11-02", verdicts: { good: 3, bad: 1 } }, { start: "2026-11-16", verdicts: { warnings: 2 } }] });
    expect(bars.map(({ start, total }) => `${start} ${total}`)).toEqual(["2026-11-02 4", "2026-11-09 0", "2026-11-16 2"]);
    expect(bars[0]?.segments).toEqual([{ verdict: "bad", count: 1, share: 0.25 }, { verdict: "good", count: 3, share: 0.75 }]);
    expect(bars[2]?.segments).toEqual([{ verdict: "warnings", count: 2, share: 0.5 }]);
  });
  it("is bounded, whatever the clock of a robot said", () => {
    const bars = barsOf({ by: "day", buckets: [{ start: "1970-01-01", verdicts: { good: 1 } }, { start: "2026-11-16", verdicts: { good: 2 } }] });
    expect(bars).toHaveLength(MAX_BARS);
    expect(bars.at(-1)).toMatchObject({ start: "2026-11-16", total: 2 });
  });
  it("is empty without missions", () => {
    expect(barsOf({ by: "week", buckets: [] })).toEqual([]);
  });
});

const shown = (before: string, after: string) => diffLines(before, after).map(({ kind, text }) => `${kind === "same" ? " " : kind === "added" ? "+" : "-"}${text}`);

describe("differences between two texts", () => {
  it("are the changed lines only", () => {
    expect(shown("a\nb\nc\n", "a\nx\nc\nd\n")).toEqual([" a", "-b", "+x", " c", "+d"]);
    expect(shown("a\nb\nc\nd\ne", "b\nc\nx\ne")).toEqual(["-a", " b", " c", "-d", "+x", " e"]);
  });
  it("are none between equal texts, whatever their line ends", () => {
    expect(folded(diffLines("a\r\nb", "a\nb\n"))).toEqual([]);
    expect(diffLines("", "")).toEqual([]);
  });
  it("are everything where one is empty", () => {
    expect(shown("", "a\nb\n")).toEqual(["+a", "+b"]);
    expect(shown("a\nb\n", "")).toEqual(["-a", "-b"]);
  });
  it("restore both texts, for any lines", () => {
    let seed = 7;
    const random = (most: number) => (seed = (seed * 16807) % 2147483647) % most;
    for (let round = 0; round < 50; round += 1) {
      const [before, after] = [0, 1].map(() => Array.from({ length: random(30) }, () => "abcd"[random(4)]).join("\n"));
      const lines = diffLines(before ?? "", after ?? "");
      expect(lines.flatMap(({ kind, text }) => (kind === "added" ? [] : [text])).join("\n")).toBe(before);
      expect(lines.flatMap(({ kind, text }) => (kind === "removed" ? [] : [text])).join("\n")).toBe(after);
      expect(lines.flatMap(({ before: number }) => (number === null ? [] : [number]))).toEqual(Array.from({ length: lines.filter(({ kind }) => kind !== "added").length }, (_, at) => at + 1));
    }
  });
  it("stay bounded for texts that have nothing in common", () => {
    const [before, after] = ["a", "b"].map((letter) => Array.from({ length: 3000 }, (_, at) => `${letter}${at}`).join("\n"));
    const lines = diffLines(before ?? "", after ?? "");
    expect(lines.filter(({ kind }) => kind === "removed")).toHaveLength(3000);
    expect(lines.filter(({ kind }) => kind === "added")).toHaveLength(3000);
  });
  it("are shown with some lines around them", () => {
    const before = Array.from({ length: 20 }, (_, at) => String(at)).join("\n");
    const lines = folded(diffLines(before, before.replace("10", "ten")), 2);
    expect(lines.map((line) => (line.kind === "skipped" ? `${line.count} skipped` : line.text))).toEqual(["8 skipped", "8", "9", "10", "ten", "11", "12", "7 skipped"]);
  });
});

describe("the text of a checks.yaml", () => {
  it("has its error at a line and column", () => {
    const problem = new Problem("yaml_invalid", 422, "", "", null, { line: 3, column: 5, reason: "unknown key" });
    expect(textErrorOf(problem)).toEqual({ line: 3, column: 5, reason: "unknown key" });
    expect(textErrorOf(new Problem("forbidden", 403, "", ""))).toBeNull();
    expect(textErrorOf(new Problem("yaml_invalid", 422, "", ""))).toBeNull();
    expect(textErrorOf(null)).toBeNull();
  });
  it("is entered at that position, which may be beyond its end, and after characters of two units", () => {
    expect(positionOf("a\nbcd\ne", 2, 3)).toBe(4);
    expect(positionOf("a\nbcd\ne", 2, 99)).toBe(5);
    expect(positionOf("a\nb", 99, 1)).toBe(2);
    expect(positionOf("\u{1F916}x", 1, 2)).toBe(2);
    expect(positionOf("", 1, 1)).toBe(0);
  });
});
