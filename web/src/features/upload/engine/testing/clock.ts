// A clock whose time passes only while somebody waits, and then at once. `pass` lets it pass by hand.

import type { Clock } from "../flow";

interface Waiter {
  readonly atMs: number;
  readonly wake: () => void;
}

export class FastClock implements Clock {
  private nowMs = Date.UTC(2026, 0, 1);
  private waiters: Waiter[] = [];
  private isPumping = false;
  private isFrozen = false;

  now(): number {
    return this.nowMs;
  }

  pass(milliseconds: number): void {
    this.nowMs += milliseconds;
  }

  async wait(milliseconds: number, signal: AbortSignal): Promise<void> {
    if (signal.aborted) return;
    await new Promise<void>((resolve) => {
      const wake = () => {
        signal.removeEventListener("abort", wake);
        this.waiters = this.waiters.filter((item) => item !== waiter);
        resolve();
      };
      const waiter = { atMs: this.nowMs + milliseconds, wake };
      this.waiters.push(waiter);
      signal.addEventListener("abort", wake);
      this.pump();
    });
  }

  /** Whoever waits waits for ever: the page has been closed. */
  freeze(): void {
    this.isFrozen = true;
  }

  private pump(): void {
    if (this.isPumping || this.isFrozen) return;
    this.isPumping = true;
    setImmediate(() => {
      this.isPumping = false;
      const [first, ...rest] = this.waiters;
      if (first === undefined || this.isFrozen) return;
      const next = rest.reduce((one, other) => (other.atMs < one.atMs ? other : one), first);
      this.nowMs = Math.max(this.nowMs, next.atMs);
      next.wake();
      this.pump();
    });
  }
}
