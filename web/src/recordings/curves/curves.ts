/** Curves over time in bounded memory: all points of short series, else the minimum and maximum of each slice. */

/** Points of several curves that share their times; `undefined`: this curve has no point here, `null`: it is broken. */
export interface Curves {
  /** Seconds since the start, ascending. */
  seconds: number[];
  values: (number | null | undefined)[][];
  /** Messages that were read. */
  messages: number;
  /** Whether these are all points, or the extremes of slices. */
  isWhole: boolean;
}

interface Extreme {
  seconds: number;
  value: number;
}

interface Slice {
  least: Extreme;
  greatest: Extreme;
}

interface Gap {
  from: number;
  length: number;
}

export const MAX_POINTS = 8_000;
const SLICES = 1_500;
const MAX_GAPS = 300;
const STEPS_SAMPLED = 2_000;
/** A silence this many times as long as usual is a gap. */
const GAP_FACTOR = 5;

/** Collects the points of `count` curves between two times, in seconds. Points come by ascending log time. */
export class CurveCollector {
  private readonly seconds: number[] = [];
  private readonly points: (number | null)[][];
  private readonly slices: Map<number, Slice>[];
  private readonly steps: number[] = [];
  private gaps: Gap[] = [];
  private readonly breaks: number[] = [];
  private last: number | undefined;
  private messages = 0;

  constructor(
    count: number,
    private readonly from: number,
    private readonly to: number,
  ) {
    this.points = Array.from({ length: count }, () => []);
    this.slices = Array.from({ length: count }, () => new Map<number, Slice>());
  }

  /** Add a message: one value a curve, null where it has none. Slices are of log time, also where `seconds` are not. */
  add(seconds: number, values: readonly (number | null)[], logSeconds = seconds): void {
    this.messages += 1;
    this.noteStep(seconds);
    if (this.messages <= MAX_POINTS) {
      this.seconds.push(seconds);
      this.points.forEach((points, curve) => points.push(values[curve] ?? null));
    }
    const place = Math.floor(((logSeconds - this.from) / Math.max(this.to - this.from, 1e-9)) * SLICES);
    this.slices.forEach((slices, curve) => {
      const value = values[curve];
      if (value !== null && value !== undefined) noteExtreme(slices, place, { seconds, value });
    });
  }

  /** Break the curves at a time at which something could not be read. */
  breakAt(seconds: number): void {
    if (this.breaks.length < MAX_GAPS) this.breaks.push(seconds);
  }

  /** What there is so far. */
  curves(): Curves {
    const isWhole = this.messages <= MAX_POINTS;
    const gaps = this.realGaps();
    const values = isWhole ? this.all(gaps) : this.extremes(gaps);
    return { ...values, messages: this.messages, isWhole };
  }

  private noteStep(seconds: number): void {
    if (this.last !== undefined) {
      const length = seconds - this.last;
      if (this.steps.length < STEPS_SAMPLED) this.steps.push(length);
      this.gaps.push({ from: this.last, length });
      if (this.gaps.length > 2 * MAX_GAPS) this.gaps = longest(this.gaps);
    }
    this.last = seconds;
  }

  /** The middles of the silences that are far longer than usual, and what was broken besides. */
  private realGaps(): number[] {
    const steps = this.steps.toSorted((a, b) => a - b);
    const usual = steps[Math.floor(steps.length / 2)] ?? 0;
    const gaps = longest(this.gaps).filter(({ length }) => length > GAP_FACTOR * usual && usual > 0);
    return [...gaps.map(({ from, length }) => from + length / 2), ...this.breaks].sort((a, b) => a - b);
  }

  private all(gaps: readonly number[]): Pick<Curves, "seconds" | "values"> {
    const rows = this.seconds.map((seconds, row) => ({ seconds, row }));
    const breaks = gaps.map((seconds) => ({ seconds, row: -1 }));
    const sorted = [...rows, ...breaks].sort((a, b) => a.seconds - b.seconds);
    return {
      seconds: sorted.map(({ seconds }) => seconds),
      values: this.points.map((points) => sorted.map(({ row }) => points[row] ?? null)),
    };
  }

  private extremes(gaps: readonly number[]): Pick<Curves, "seconds" | "values"> {
    const perCurve = this.slices.map((slices) => {
      const points = new Map<number, number | null>(gaps.map((seconds) => [seconds, null]));
      for (const { least, greatest } of slices.values()) {
        points.set(least.seconds, least.value);
        points.set(greatest.seconds, greatest.value);
      }
      return points;
    });
    const seconds = [...new Set(perCurve.flatMap((points) => [...points.keys()]))].sort((a, b) => a - b);
    return { seconds, values: perCurve.map((points) => seconds.map((second) => points.get(second))) };
  }
}

function noteExtreme(slices: Map<number, Slice>, place: number, point: Extreme): void {
  const slice = slices.get(place);
  if (slice === undefined) slices.set(place, { least: point, greatest: point });
  else if (point.value < slice.least.value) slice.least = point;
  else if (point.value > slice.greatest.value) slice.greatest = point;
}

function longest(gaps: readonly Gap[]): Gap[] {
  return gaps.toSorted((a, b) => b.length - a.length).slice(0, MAX_GAPS);
}
