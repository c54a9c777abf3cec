// Requests that a form or a button sends: one at a time. The error is stored to be shown, or shown as a toast.
import { ref, shallowRef, type Ref } from "vue";
import { showToast } from "./toasts";
import { toProblem, type Problem } from "@/api/problem";

export interface Submission {
  readonly isBusy: Ref<boolean>;
  /** The error of the last attempt, until the next one. */
  readonly problem: Ref<Problem | null>;
  /** Does `work`, unless the work before is still running. Returns whether it succeeded. */
  readonly submit: (work: () => Promise<unknown>) => Promise<boolean>;
}

export function useSubmit(): Submission {
  const isBusy = ref(false);
  const problem = shallowRef<Problem | null>(null);

  async function submit(work: () => Promise<unknown>): Promise<boolean> {
    if (isBusy.value) return false;
    isBusy.value = true;
    problem.value = null;
    try {
      await work();
    } catch (thrown) {
      problem.value = toProblem(thrown);
    } finally {
      isBusy.value = false;
    }
    return problem.value === null;
  }

  return { isBusy, problem, submit };
}

/** Does `work`; shows an error as a toast. */
export async function withToast(work: () => Promise<unknown>): Promise<void> {
  try {
    await work();
  } catch (thrown) {
    showToast({ tone: "bad", text: toProblem(thrown).message });
  }
}
