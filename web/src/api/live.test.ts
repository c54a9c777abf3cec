import { afterEach, expect, it, vi } from "vitest";
import { keysOf, refetching } from "./live";
import { keys } from "./queries";

afterEach(() => vi.useRealTimers());

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

it("makes old a map where a mission may have moved, and not with each list of missions", () => {
  const moving = ["file", "mission", "project", "grant"];
  const others = ["recording", "run", "upload", "mission_event", "action", "share", "viewer_layout"];
  const moves = (resource_type: string) => keysOf("change", { ...change, resource_type }).some(([first]) => first === keys.missionPositions()[0]);
  expect([...moving, ...others].filter(moves)).toEqual(moving);
  expect(keys.missionPositions({ name: "a" }).slice(0, 2)).not.toEqual(["missions", "list"]);
});

it("refetches what has changed together, and once in a time while it changes constantly", () => {
  vi.useFakeTimers();
  const refetched: (readonly unknown[])[] = [];
  const { add, stop } = refetching(15_000, (key) => refetched.push(key));
  add(["a"]);
  add(["b"]);
  add(["a"]);
  vi.advanceTimersByTime(1_000);
  expect(refetched).toEqual([["a"], ["b"]]);
  for (let second = 0; second < 60; second += 1) {
    add(["a"]);
    vi.advanceTimersByTime(1_000);
  }
  expect(refetched).toHaveLength(2 + 4);
  add(["a"]);
  stop();
  vi.advanceTimersByTime(60_000);
  expect(refetched).toHaveLength(2 + 4);
});
