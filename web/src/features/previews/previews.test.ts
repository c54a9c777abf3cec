import { expect, it } from "vitest";
import { sizeOfCopy } from "./thumbnails";

it("a picture is copied at a small size, and one that is small or has none of its own is not", () => {
  expect(sizeOfCopy(3200, 1600)).toEqual({ width: 160, height: 80 });
  expect(sizeOfCopy(10, 4000)).toEqual({ width: 1, height: 160 });
  expect([sizeOfCopy(160, 90), sizeOfCopy(0, 0)]).toEqual([null, null]);
});
