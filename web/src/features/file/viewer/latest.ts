// Doing one thing at a time, and of what was asked meanwhile only the last.

/** Returns a function that does `act` with what it was last given, as soon as the one before is done. */
export function latest<Asked>(act: (asked: Asked) => Promise<void>): (asked: Asked) => void {
  let waiting: { readonly asked: Asked } | null = null;
  let isBusy = false;

  async function run(): Promise<void> {
    isBusy = true;
    try {
      for (let next = waiting; next !== null; next = waiting) {
        waiting = null;
        await act(next.asked);
      }
    } finally {
      isBusy = false;
    }
  }

  return (asked) => {
    waiting = { asked };
    if (!isBusy) void run();
  };
}
