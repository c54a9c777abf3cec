import { expect, test } from "vitest";
import { ifStill, ledTo } from "./etags";

test("a change names the etag that was looked at", () => {
  expect(ifStill("a0")).toEqual({ "If-Match": '"a0"' });
  expect(ifStill(undefined)).toEqual({});
});

test("what this page made of it counts as looked at, and going back ends nowhere", () => {
  ledTo("b0", "b1");
  ledTo("b1", "b2");
  expect(ifStill("b0")).toEqual({ "If-Match": '"b2"' });
  ledTo("b2", "b0");
  expect(ifStill("b1")).toEqual({ "If-Match": '"b0"' });
  expect(ifStill("b0")).toEqual({ "If-Match": '"b0"' });
});
