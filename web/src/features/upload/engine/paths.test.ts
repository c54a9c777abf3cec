// @vitest-environment node
import { describe, expect, it } from "vitest";
import { checkFilePath, nameKey } from "./paths";

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
