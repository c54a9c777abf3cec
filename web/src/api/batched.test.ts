import { expect, it } from "vitest";
import { batched } from "./batched";

it("loads what is asked for at the same time with one request, at most some keys with each", async () => {
  const requests: (readonly string[])[] = [];
  const load = batched((keys) => {
    requests.push(keys);
    return Promise.resolve(new Map(keys.filter((key) => key !== "none").map((key) => [key, key.toUpperCase()])));
  }, 3);
  expect(await Promise.all(["a", "b", "a", "none", "c"].map(load))).toEqual(["A", "B", "A", undefined, "C"]);
  expect(requests).toEqual([["a", "b", "none"], ["c"]]);
  expect(await load("a")).toBe("A");
  expect(requests).toHaveLength(3);
});

it("fails for all that asked, and loads again for those that ask later", async () => {
  let isDown = true;
  const load = batched((keys) => (isDown ? Promise.reject(new Error("down")) : Promise.resolve(new Map(keys.map((key) => [key, 1])))), 10);
  const outcomes = await Promise.allSettled([load("a"), load("b")]);
  expect(outcomes.map(({ status }) => status)).toEqual(["rejected", "rejected"]);
  isDown = false;
  expect(await load("a")).toBe(1);
});
