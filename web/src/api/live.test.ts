import { expect, it } from "vitest";
import { keysOf } from "./live";

const change = { resource_type: "file", change: "changed", id: "f", mission_id: "m", project_id: "p" };

it("makes old what a change of a file shows in", () => {
  const keys = keysOf("change", change);
  expect(keys).toContainEqual(["missions", "one", "m"]);
  expect(keys).toContainEqual(["files", "one", "f"]);
  expect(keysOf("change", { ...change, id: null })).toContainEqual(["files", "one"]);
});

it("makes old the previews of a mission, and nothing else of it, when a run on it changes", () => {
  const keys = keysOf("change", { ...change, resource_type: "run", id: "r" });
  expect(keys).toContainEqual(["runs", "one", "r"]);
  expect(keys.filter(([first]) => first === "missions")).toEqual([["missions", "one", "m", "previews"]]);
});

it("makes old everything where something was missed, and nothing for resource types that nobody shows", () => {
  expect(keysOf("refetch", { reason: "rights" })).toEqual([[]]);
  expect(keysOf("change", { ...change, resource_type: "weather" })).toEqual([]);
  expect(keysOf("change", "markup")).toEqual([]);
});
