// Concurrency primitives of an upload: queues, a budget for work in progress, pausing, waits that can be interrupted.

/** The upload was stopped. */
export class Stopped extends Error {
  override readonly name = "Stopped";
}

/** Time as an upload sees it; tests bring their own. */
export interface Clock {
  /** Milliseconds since 1970. */
  now(): number;
  /** Resolves after so long, or as soon as `signal` aborts. */
  wait(milliseconds: number, signal: AbortSignal): Promise<void>;
}

export const realClock: Clock = {
  now: () => Date.now(),
  wait: (milliseconds, signal) =>
    new Promise((resolve) => {
      if (signal.aborted) {
        resolve();
        return;
      }
      const done = () => {
        clearTimeout(timer);
        signal.removeEventListener("abort", done);
        resolve();
      };
      const timer = setTimeout(done, milliseconds);
      signal.addEventListener("abort", done);
    }),
};

export function checkStopped(signal: AbortSignal): void {
  if (signal.aborted) throw new Stopped();
}

/**
 * A condition variable: `wake` resumes all waits, and each checks its condition again. The queues and budgets of one upload
 * share it, so that the upload has one listener on its signal for all of them.
 */
export class Changed {
  private wakers: (() => void)[] = [];

  constructor(readonly signal: AbortSignal) {
    signal.addEventListener("abort", () => this.wake());
  }

  wake(): void {
    const wakers = this.wakers;
    this.wakers = [];
    for (const waker of wakers) waker();
  }

  /** @throws Stopped */
  async next(): Promise<void> {
    checkStopped(this.signal);
    await new Promise<void>((resolve) => this.wakers.push(resolve));
    checkStopped(this.signal);
  }
}

/** A queue between two loops, first in, first out. */
export class Queue<T> {
  private readonly items: T[] = [];

  constructor(
    private readonly changed: Changed,
    private readonly clock: Clock,
  ) {}

  put(item: T): void {
    this.items.push(item);
    this.changed.wake();
  }

  /** Return the queued items; waits until there is one. @throws Stopped */
  async take(atMost: number): Promise<T[]> {
    while (this.items.length === 0) await this.changed.next();
    checkStopped(this.changed.signal);
    return this.items.splice(0, atMost);
  }

  /** Return the items after a delay, or once `atMost` are there. @throws Stopped */
  async gather(atMost: number, milliseconds: number): Promise<T[]> {
    if (this.items.length < atMost) await this.clock.wait(milliseconds, this.changed.signal);
    checkStopped(this.changed.signal);
    return this.items.splice(0, atMost);
  }
}

/**
 * A limit on work in progress. A single item above the limit runs alone. Those that wait continue when
 * half of the limit is free, so that work comes in batches.
 */
export class Budget {
  private taken = 0;

  constructor(
    private readonly changed: Changed,
    private readonly limit: number,
  ) {}

  get used(): number {
    return this.taken;
  }

  /** @throws Stopped */
  async acquire(amount: number): Promise<void> {
    let room = this.limit;
    while (this.taken > 0 && this.taken + amount > room) {
      room = this.limit / 2;
      await this.changed.next();
    }
    this.taken += amount;
  }

  release(amount: number): void {
    this.taken -= amount;
    this.changed.wake();
  }

  /** Wait until nothing is under way. @throws Stopped */
  async drained(): Promise<void> {
    while (this.taken > 0) await this.changed.next();
  }
}

/** Pauses an upload. While the gate is shut, no request starts, and running transfers are aborted. */
export class Gate {
  private shut = false;
  private calling = new AbortController();
  private readonly changed: Changed;

  constructor(private readonly signal: AbortSignal) {
    this.changed = new Changed(signal);
    signal.addEventListener("abort", () => this.calling.abort());
  }

  get isShut(): boolean {
    return this.shut;
  }

  /** Aborts when the gate shuts, or when it is over. */
  get called(): AbortSignal {
    return this.calling.signal;
  }

  close(): void {
    this.shut = true;
    this.calling.abort();
  }

  open(): void {
    if (!this.shut || this.signal.aborted) return;
    this.shut = false;
    this.calling = new AbortController();
    this.changed.wake();
  }

  /** Wait until the gate is open. @throws Stopped */
  async passed(): Promise<void> {
    while (this.shut) await this.changed.next();
    checkStopped(this.signal);
  }
}
