import { expect, it } from "vitest";
import { validateParameters, validateParameter, sent } from "./queries";
import type { Parameter } from "@/api/types";

function parameter(name: string, type: Parameter["type"], more: Partial<Parameter> = {}): Parameter {
  return { name, type, description: "", ...more };
}

it("a number is within its bounds, which belong to it", () => {
  const speed = parameter("speed", "number", { minimum: 0, maximum: 10 });
  expect([0, 10].map((value) => validateParameter(speed, value))).toEqual([null, null]);
  expect([-0.1, 10.1, Number.NaN, "fast"].every((value) => validateParameter(speed, value) !== null)).toBe(true);
});

it("a whole number has no fraction", () => {
  expect(validateParameter(parameter("count", "integer"), 2.5)).not.toBeNull();
  expect(validateParameter(parameter("count", "integer"), 2)).toBeNull();
});

it("what has no default must be said, also where it is false or zero", () => {
  const all = [parameter("a", "string"), parameter("b", "string", { default: "x" }), parameter("c", "boolean"), parameter("d", "integer")];
  expect([...validateParameters(all, { a: "", c: false, d: 0 }).keys()]).toEqual(["a"]);
});

it("only what was given is sent", () => {
  const all = [parameter("a", "string"), parameter("b", "boolean"), parameter("c", "number")];
  expect(sent(all, { a: "", b: false, c: 0, gone: "x" })).toEqual({ b: false, c: 0 });
});
