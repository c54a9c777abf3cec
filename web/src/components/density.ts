// How full each part of a span is, as a path that can be drawn in any size.

/** Returns the drawn columns of a row of counts, in a box of `counts.length` by 1; an empty part leaves a gap. */
export function densityPath(counts: readonly number[]): string {
  const most = counts.reduce((high, count) => Math.max(high, count), 0);
  if (most === 0) return "";
  let path = "";
  let at = 0;
  while (at < counts.length) {
    const count = counts[at] ?? 0;
    let end = at + 1;
    while (end < counts.length && counts[end] === count) end += 1;
    // The root makes a lone message beside thousands still be seen.
    const height = count === 0 ? 0 : Math.max(0.2, Math.sqrt(count / most));
    if (height > 0) path += `M${at} 1V${(1 - height).toFixed(3)}H${end}V1Z`;
    at = end;
  }
  return path;
}

/** Returns the longest stretch of empty parts between two full ones, as a share of the whole. */
export function longestGap(counts: readonly number[]): number {
  const first = counts.findIndex((count) => count > 0);
  let longest = 0;
  let run = 0;
  for (const count of first < 0 ? [] : counts.slice(first)) {
    if (count > 0) {
      longest = Math.max(longest, run);
      run = 0;
    } else run += 1;
  }
  return counts.length === 0 ? 0 : longest / counts.length;
}
