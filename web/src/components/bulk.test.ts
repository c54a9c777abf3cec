import { expect, it } from "vitest";
import { useBulkChange } from "./bulk";
import { Problem } from "@/api/problem";

it("does what it can, and names each item that failed with the server's reason", async () => {
  const { run, failures, finished, isRunning } = useBulkChange();
  const items = Array.from({ length: 9 }, (_, at) => ({ id: String(at), name: `mission ${at}` }));
  const did: string[] = [];
  const succeeded = await run(items, async (id) => {
    await Promise.resolve();
    if (id === "3") throw new Problem("forbidden", 403, "Forbidden", "You may not delete this mission.");
    did.push(id);
  });
  expect([succeeded, finished.value, isRunning.value, did.length]).toEqual([8, 9, false, 8]);
  expect(failures.value).toEqual([{ id: "3", name: "mission 3", detail: "You may not delete this mission." }]);
});
