// A change of many items. An item that fails does not stop the others.
import { ref, type Ref } from "vue";
import { toProblem, type Problem } from "@/api/problem";

export interface Item {
  readonly id: string;
  readonly name: string;
}

export interface Failure extends Item {
  readonly problem: Problem;
}

export interface BulkChange {
  readonly isRunning: Ref<boolean>;
  readonly finished: Ref<number>;
  readonly total: Ref<number>;
  readonly failures: Ref<readonly Failure[]>;
  /** Does `act` for each item; returns how many succeeded. */
  readonly run: (items: readonly Item[], act: (id: string) => Promise<unknown>) => Promise<number>;
}

const AT_ONCE = 4;

export function useBulkChange(): BulkChange {
  const isRunning = ref(false);
  const finished = ref(0);
  const total = ref(0);
  const failures = ref<readonly Failure[]>([]);

  async function run(items: readonly Item[], act: (id: string) => Promise<unknown>): Promise<number> {
    [isRunning.value, finished.value, total.value, failures.value] = [true, 0, items.length, []];
    const waiting = items.values();
    async function work(): Promise<void> {
      for (const item of waiting) {
        try {
          await act(item.id);
        } catch (thrown) {
          failures.value = [...failures.value, { ...item, problem: toProblem(thrown) }];
        }
        finished.value += 1;
      }
    }
    await Promise.all(Array.from({ length: AT_ONCE }, work));
    isRunning.value = false;
    return items.length - failures.value.length;
  }

  return { isRunning, finished, total, failures, run };
}
