// The differences between two texts, line by line (Myers, "An O(ND) Difference Algorithm and Its Variations", 1986).

export interface DiffLine {
  readonly kind: "same" | "added" | "removed";
  readonly text: string;
  /** Line numbers from 1; null where the text has no such line. */
  readonly before: number | null;
  readonly after: number | null;
}

/** Lines that were left out between two changes. */
export interface Skipped {
  readonly kind: "skipped";
  readonly count: number;
}

/** More changes than this are shown as all removed, then all added, because the search would be slow. */
const MAX_CHANGES = 2000;

type Pair = readonly [number, number];

/** Returns the pairs of equal lines of a shortest edit script; none where it would be longer than `MAX_CHANGES`. */
function equalPairs(before: readonly string[], after: readonly string[]): readonly Pair[] {
  const most = Math.min(MAX_CHANGES, before.length + after.length);
  const trace: Map<number, number>[] = [];
  let furthest = new Map<number, number>([[1, 0]]);
  for (let changes = 0; changes <= most; changes += 1) {
    const next = new Map<number, number>();
    for (let diagonal = -changes; diagonal <= changes; diagonal += 2) {
      const [down, right] = [furthest.get(diagonal + 1) ?? -1, furthest.get(diagonal - 1) ?? -1];
      let x = diagonal === -changes || (diagonal !== changes && right < down) ? down : right + 1;
      while (x < before.length && x - diagonal < after.length && before[x] === after[x - diagonal]) x += 1;
      next.set(diagonal, x);
      if (x >= before.length && x - diagonal >= after.length) return tracedBack([...trace, furthest], before.length, after.length);
    }
    trace.push(furthest);
    furthest = next;
  }
  return [];
}

function tracedBack(trace: readonly Map<number, number>[], beforeLength: number, afterLength: number): readonly Pair[] {
  const pairs: Pair[] = [];
  let [x, y] = [beforeLength, afterLength];
  for (let changes = trace.length - 1; changes >= 0; changes -= 1) {
    const furthest = trace[changes] ?? new Map<number, number>();
    const diagonal = x - y;
    const [down, right] = [furthest.get(diagonal + 1) ?? -1, furthest.get(diagonal - 1) ?? -1];
    const previous = diagonal === -changes || (diagonal !== changes && right < down) ? diagonal + 1 : diagonal - 1;
    const previousX = changes === 0 ? 0 : (furthest.get(previous) ?? 0);
    const previousY = changes === 0 ? 0 : previousX - previous;
    while (x > previousX && y > previousY) pairs.push([(x -= 1), (y -= 1)]);
    [x, y] = [previousX, previousY];
  }
  return pairs.reverse();
}

function linesOf(text: string): readonly string[] {
  const lines = text.split(/\r?\n/);
  return lines.at(-1) === "" ? lines.slice(0, -1) : lines;
}

/** Returns all lines of both texts in order: of each change, those removed before those added. */
export function diffLines(beforeText: string, afterText: string): readonly DiffLine[] {
  const [before, after] = [linesOf(beforeText), linesOf(afterText)];
  const least = Math.min(before.length, after.length);
  let head = 0;
  while (head < least && before[head] === after[head]) head += 1;
  let tail = 0;
  while (tail < least - head && before[before.length - 1 - tail] === after[after.length - 1 - tail]) tail += 1;
  const middle = equalPairs(before.slice(head, before.length - tail), after.slice(head, after.length - tail));
  const pairs: Pair[] = [
    ...Array.from({ length: head }, (_, at): Pair => [at, at]),
    ...middle.map(([one, other]): Pair => [one + head, other + head]),
    ...Array.from({ length: tail }, (_, at): Pair => [before.length - tail + at, after.length - tail + at]),
    [before.length, after.length],
  ];
  const result: DiffLine[] = [];
  let [x, y] = [0, 0];
  for (const [equalX, equalY] of pairs) {
    for (; x < equalX; x += 1) result.push({ kind: "removed", text: before[x] ?? "", before: x + 1, after: null });
    for (; y < equalY; y += 1) result.push({ kind: "added", text: after[y] ?? "", before: null, after: y + 1 });
    if (x < before.length && y < after.length) result.push({ kind: "same", text: before[x] ?? "", before: (x += 1), after: (y += 1) });
  }
  return result;
}

/** Returns the lines with only some equal ones around each change; an empty list where nothing changed. */
export function folded(lines: readonly DiffLine[], context = 3): readonly (DiffLine | Skipped)[] {
  const isNear = lines.map(() => false);
  lines.forEach(({ kind }, at) => {
    if (kind === "same") return;
    for (let near = Math.max(0, at - context); near <= Math.min(lines.length - 1, at + context); near += 1) isNear[near] = true;
  });
  if (!isNear.includes(true)) return [];
  const result: (DiffLine | Skipped)[] = [];
  let skipped = 0;
  lines.forEach((line, at) => {
    if (!isNear[at]) {
      skipped += 1;
      return;
    }
    if (skipped > 0) result.push({ kind: "skipped", count: skipped });
    skipped = 0;
    result.push(line);
  });
  if (skipped > 0) result.push({ kind: "skipped", count: skipped });
  return result;
}
