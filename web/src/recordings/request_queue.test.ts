import { expect, it } from "vitest";
import { RequestQueue } from "./request_queue";

it("returns the most urgent request first, and of equal ones the oldest", () => {
  const queue = new RequestQueue();
  for (const [id, priority] of [[1, 5], [2, 0], [3, 5], [4, 0], [5, 2]] as const) queue.add({ id, priority });
  expect([1, 2, 3, 4, 5].map(() => queue.take()?.id)).toEqual([2, 4, 5, 1, 3]);
  expect(queue.take()).toBeNull();
});

it("returns only what is more urgent than a limit", () => {
  const queue = new RequestQueue();
  queue.add({ id: 1, priority: 3 });
  expect(queue.take(3)).toBeNull();
  expect(queue.take(4)?.id).toBe(1);
});

it("forgets a request that is cancelled", () => {
  const queue = new RequestQueue();
  queue.add({ id: 1, priority: 0 });
  queue.add({ id: 2, priority: 0 });
  expect(queue.remove(1)?.id).toBe(1);
  expect(queue.remove(1)).toBeNull();
  expect(queue.take()?.id).toBe(2);
});
