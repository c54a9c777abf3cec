import { expect, it } from "vitest";
import { useBulkChange } from "./bulk";
import { Problem } from "@/api/problem";

it("changes the other items if one fails, and reports the error of that one", async () => {
  const { run, failures, finished, isRunning } = useBulkChange();
  const items = Array.from({ length: 9 }, (_, at) => ({ id: String(at), name: `mission ${at}` }));
  const did: string[] = [];
  const succeeded = await run(items, async (id) => {
    await Promise.resolve();
    if (id === "3") throw new Problem("forbidden", 403, "Forbidden", "You may not delete this mission.");
    did.push(id);
  });
  expect([succeeded, finished.value, isRunning.value, did.length]).toEqual([8, 9, false, 8]);
  expect(failures.value.map(({ name, problem }) => [name, problem.code, problem.message])).toEqual([["mission 3", "forbidden", "You may not delete this mission."]]);
});
