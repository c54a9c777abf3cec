import { describe, expect, it } from "vitest";
import { LogLines, shownLine } from "./log";

describe("lines of a log", () => {
  it("are the same however they came", () => {
    const log = new LogLines();
    for (const piece of ["one\ntw", "o\n", "\nfour", "", " and more"]) log.append(piece);
    expect(Array.from({ length: log.end }, (_, at) => log.line(at))).toEqual(["one", "two", "", "four and more"]);
    log.append("\n");
    expect([log.end, log.line(3), log.line(4)]).toEqual([4, "four and more", ""]);
  });
  it("keep their numbers when the earliest are let go", () => {
    const log = new LogLines(3);
    for (let at = 0; at < 10; at += 1) log.append(`line ${at}\n`);
    expect([log.first, log.end, log.line(0), log.line(9)]).toEqual([7, 10, "", "line 9"]);
  });
  it("are found piece by piece, whatever their case, each once", () => {
    const log = new LogLines();
    log.append("an Error, error\nfine\n");
    log.append("fine\nERROR\n");
    const first = log.find("error", 0);
    expect(first).toEqual({ found: [0], upTo: 2 });
    expect(log.find("error", first.upTo)).toEqual({ found: [3], upTo: 4 });
    expect(log.find("error", 4)).toEqual({ found: [], upTo: 4 });
  });
});

describe("a line as it is shown", () => {
  it("is what a terminal would leave of it", () => {
    expect(shownLine("10 %\r50 %\r100 %\r", "…")).toBe("100 %");
    expect(shownLine("\u001b[31mred\u001b[0m \u0007bell", "…")).toBe("red bell");
  });
  it("is cut where nobody reads on", () => {
    expect(shownLine("x".repeat(5000), "…")).toHaveLength(2001);
  });
});
