// Keeps the names of uploads that are being hashed or sent: asking for a part's address renews its upload's lease.

import type { Asking, Surroundings } from "./api";
import { checkStopped } from "./flow";
import type { Sending } from "./sending";

const RENEW_MS = 20_000;

export class Leases {
  private readonly held = new Set<Sending>();

  constructor(
    private readonly asking: Asking,
    private readonly around: Surroundings,
    private readonly signal: AbortSignal,
  ) {}

  hold(sending: Sending): void {
    this.held.add(sending);
  }

  letGo(sending: Sending): void {
    this.held.delete(sending);
  }

  /** Renew what is due, for ever; `failed` hears of what one upload's renewal said. @throws Stopped */
  async renewing(failed: (sending: Sending, error: unknown) => Promise<void>): Promise<never> {
    for (;;) {
      await this.around.clock.wait(RENEW_MS, this.signal);
      checkStopped(this.signal);
      const due = this.around.clock.now() - RENEW_MS;
      for (const sending of this.held) {
        // A paused upload holds no names: they may be taken by whoever goes on.
        if (this.around.gate.isShut || sending.ended || sending.latest === null || sending.renewedMs >= due) continue;
        sending.renewedMs = this.around.clock.now();
        try {
          await this.asking.sign([sending.latest]);
        } catch (error) {
          await failed(sending, error);
        }
      }
    }
  }
}
