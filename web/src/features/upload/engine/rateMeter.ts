// How far an upload is, how fast it goes and how long it still takes. Pure: it is told the time.

const WINDOW_MS = 10_000;
const SOONEST_MS = 1_500;

export interface Rate {
  readonly bytesPerS: number | null;
  readonly leftS: number | null;
}

/** The rate over the last seconds in which anything was expected to move. */
export class RateMeter {
  private samples: { readonly atMs: number; readonly bytes: number }[] = [];
  private sent = 0;

  /** Bytes that moved; negative when they must move again. */
  moved(sizeBytes: number): void {
    this.sent += sizeBytes;
  }

  /** Forget the past: after a pause it says nothing of what comes. */
  restart(): void {
    this.samples = [];
  }

  /** Return the rate now, and how long `leftBytes` take at it; null where too little is known. */
  at(nowMs: number, leftBytes: number): Rate {
    if (this.sent === 0) return { bytesPerS: null, leftS: null }; // it still reads: that says nothing of sending
    this.samples.push({ atMs: nowMs, bytes: this.sent });
    while (this.samples.length > 2 && (this.samples[1]?.atMs ?? nowMs) < nowMs - WINDOW_MS) this.samples.shift();
    const first = this.samples[0];
    if (first === undefined || nowMs - first.atMs < SOONEST_MS) return { bytesPerS: null, leftS: null };
    const bytesPerS = Math.max(0, ((this.sent - first.bytes) * 1000) / (nowMs - first.atMs));
    return { bytesPerS, leftS: bytesPerS > 0 ? leftBytes / bytesPerS : null };
  }
}
