import { expect, test } from "vitest";
import { layoutFor } from "./layout";

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
