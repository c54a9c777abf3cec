import { expect, it } from "vitest";
import { ChunkCache } from "./chunk_cache";

function counting(): { load: (length: number) => () => Promise<Uint8Array>; loads: () => number } {
  let loads = 0;
  const load = (length: number) => () => {
    loads += 1;
    return Promise.resolve(new Uint8Array(length));
  };
  return { load, loads: () => loads };
}

it("loads a chunk once", async () => {
  const { load, loads } = counting();
  const cache = new ChunkCache(100);
  const first = await cache.get(8, load(40));
  expect(await cache.get(8, load(40))).toBe(first);
  expect([loads(), cache.bytes]).toEqual([1, 40]);
});

it("stays within its budget, and drops the least recently used chunk", async () => {
  const { load, loads } = counting();
  const cache = new ChunkCache(100);
  for (const at of [1, 2, 1, 3]) await cache.get(at, load(40));
  expect([loads(), cache.bytes]).toEqual([3, 80]);
  await cache.get(1, load(40));
  expect(loads()).toBe(3);
  await cache.get(2, load(40));
  expect(loads()).toBe(4);
});

it("does not keep a chunk that is larger than its budget", async () => {
  const { load, loads } = counting();
  const cache = new ChunkCache(100);
  await cache.get(1, load(101));
  await cache.get(1, load(101));
  expect([loads(), cache.bytes]).toEqual([2, 0]);
});

it("does not remember a chunk that could not be loaded", async () => {
  const { load } = counting();
  const cache = new ChunkCache(100);
  await expect(cache.get(1, () => Promise.reject(new Error("damaged")))).rejects.toThrow("damaged");
  expect((await cache.get(1, load(10))).length).toBe(10);
});
