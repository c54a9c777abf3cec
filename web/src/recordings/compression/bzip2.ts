/** bzip2, strictly within bounds: what some ROS 1 bags call "bz2". Slow (about 10 MB/s), which suits chunks of 768 kB.
 *
 * Source: the format as J. Tsai describes it in "bzip2: format specification" (2016). Checksums are not compared.
 */

const BLOCK_MAGIC = 0x314159265359;
const END_MAGIC = 0x177245385090;
const SYMBOLS_PER_SELECTOR = 50;
const MAX_BITS = 20;
const RUN_A = 0;
const RUN_B = 1;

/** Return what `packed` holds: exactly `size` bytes.
 *
 * @throws RangeError where it is not bzip2, or holds more or less than that.
 */
export function unpackBzip2(packed: Uint8Array, size: number): Uint8Array {
  const bits = new Bits(packed);
  if (bits.take(24) !== 0x425a68) throw new RangeError("no bzip2 stream");
  const level = bits.take(8) - 0x30;
  if (level < 1 || level > 9) throw new RangeError("an unknown bzip2 level");
  const target = new Uint8Array(size);
  const row = new Uint32Array(level * 100_000);
  let filled = 0;
  for (;;) {
    const magic = bits.take(24) * 2 ** 24 + bits.take(24);
    bits.take(16);
    bits.take(16); // a checksum
    if (magic === END_MAGIC) break;
    if (magic !== BLOCK_MAGIC) throw new RangeError("no bzip2 block");
    filled = oneBlock(bits, row, target, filled);
  }
  if (filled !== size) throw new RangeError(`${filled} bytes instead of ${size}`);
  return target;
}

class Bits {
  private at = 0;
  private word = 0;
  private left = 0;

  constructor(private readonly bytes: Uint8Array) {}

  /** Take up to 24 bits, the highest first. */
  take(count: number): number {
    while (this.left < count) {
      const next = this.bytes[this.at++];
      if (next === undefined) throw new RangeError("bzip2 is cut off");
      this.word = ((this.word & 0xffffff) << 8) | next;
      this.left += 8;
    }
    this.left -= count;
    return (this.word >>> this.left) & (2 ** count - 1);
  }
}

function oneBlock(bits: Bits, row: Uint32Array, target: Uint8Array, filled: number): number {
  if (bits.take(1) === 1) throw new RangeError("bzip2 with random blocks is not read here");
  const start = bits.take(24);
  const alphabet = usedBytes(bits);
  const tables = bits.take(3);
  if (tables < 2 || tables > 6) throw new RangeError("a wrong number of bzip2 tables");
  const selectors = moveToFrontSelectors(bits, tables);
  const codes = Array.from({ length: tables }, () => new Codes(bits, alphabet.length + 2));
  const length = symbols(bits, codes, selectors, alphabet, row);
  if (start >= length) throw new RangeError("a bzip2 block begins behind its end");
  return unsort(row, length, start, target, filled);
}

function usedBytes(bits: Bits): number[] {
  const groups = bits.take(16);
  const used: number[] = [];
  for (let group = 0; group < 16; group++) {
    if ((groups & (0x8000 >> group)) === 0) continue;
    const members = bits.take(16);
    for (let byte = 0; byte < 16; byte++) if (members & (0x8000 >> byte)) used.push(group * 16 + byte);
  }
  if (used.length === 0) throw new RangeError("a bzip2 block without bytes");
  return used;
}

function moveToFrontSelectors(bits: Bits, tables: number): number[] {
  const order = Array.from({ length: tables }, (_, table) => table);
  return Array.from({ length: bits.take(15) }, () => {
    let place = 0;
    while (bits.take(1) === 1) place += 1;
    return toFront(order, place);
  });
}

function toFront(order: number[], place: number): number {
  const [value] = order.splice(place, 1);
  if (value === undefined) throw new RangeError("a bzip2 symbol out of bounds");
  order.unshift(value);
  return value;
}

/** Canonical Huffman codes: by length, the first code, and where its symbols begin. */
class Codes {
  private readonly counts = new Uint16Array(MAX_BITS + 2);
  private readonly symbols: number[] = [];

  constructor(bits: Bits, size: number) {
    const lengths: number[] = [];
    let length = bits.take(5);
    for (let symbol = 0; symbol < size; symbol++) {
      while (bits.take(1) === 1) length += bits.take(1) === 0 ? 1 : -1;
      if (length < 1 || length > MAX_BITS) throw new RangeError("a bzip2 code of a wrong length");
      lengths.push(length);
    }
    for (let bitLength = 1; bitLength <= MAX_BITS; bitLength++) {
      for (let symbol = 0; symbol < size; symbol++) if (lengths[symbol] === bitLength) this.symbols.push(symbol);
      this.counts[bitLength] = lengths.filter((item) => item === bitLength).length;
    }
  }

  next(bits: Bits): number {
    let code = 0;
    let first = 0;
    let begin = 0;
    for (let length = 1; length <= MAX_BITS; length++) {
      code = code * 2 + bits.take(1);
      const count = this.counts[length] ?? 0;
      const symbol = this.symbols[begin + code - first];
      if (code - first < count && symbol !== undefined) return symbol;
      begin += count;
      first = (first + count) * 2;
    }
    throw new RangeError("an unknown bzip2 code");
  }
}

/** Undo Huffman, runs and move-to-front; the bytes of the block are the low 8 bits of `row`. Return how many. */
function symbols(bits: Bits, codes: Codes[], selectors: number[], alphabet: number[], row: Uint32Array): number {
  const end = alphabet.length + 1;
  const order = [...alphabet];
  let length = 0;
  let run = 0;
  let weight = 1;
  for (let number = 0; ; number++) {
    const table = codes[selectors[Math.floor(number / SYMBOLS_PER_SELECTOR)] ?? -1];
    if (table === undefined) throw new RangeError("a bzip2 block without an end");
    const symbol = table.next(bits);
    if (symbol === RUN_A || symbol === RUN_B) {
      run += weight * (symbol + 1);
      weight *= 2;
      if (run > row.length) throw new RangeError("a bzip2 run out of bounds");
      continue;
    }
    if (length + run + 1 > row.length + (symbol === end ? 1 : 0)) throw new RangeError("a bzip2 block is too long");
    row.fill(order[0] ?? 0, length, length + run);
    length += run;
    run = 0;
    weight = 1;
    if (symbol === end) return length;
    row[length++] = toFront(order, symbol - 1);
  }
}

/** Undo the Burrows-Wheeler transform and the outer runs (four equal bytes, then how many more). */
function unsort(row: Uint32Array, length: number, start: number, target: Uint8Array, filledBefore: number): number {
  const places = new Uint32Array(257);
  for (let at = 0; at < length; at++) bump(places, ((row[at] ?? 0) & 255) + 1, 1);
  for (let byte = 0; byte < 256; byte++) bump(places, byte + 1, places[byte] ?? 0);
  for (let at = 0; at < length; at++) bump(row, bump(places, (row[at] ?? 0) & 255, 1), at * 256);
  let filled = filledBefore;
  let next = (row[start] ?? 0) >>> 8;
  let equal = 0;
  let before = -1;
  for (let at = 0; at < length; at++) {
    const entry = row[next] ?? 0;
    const byte = entry & 255;
    next = entry >>> 8;
    const count = equal === 4 ? byte : 1;
    if (filled + count > target.length) throw new RangeError("bzip2 holds more than promised");
    target.fill(equal === 4 ? before : byte, filled, filled + count);
    filled += count;
    equal = equal === 4 ? 0 : byte === before ? equal + 1 : 1;
    before = equal === 0 ? -1 : byte;
  }
  return filled;
}

/** Add to a number in place; return what it was. */
function bump(numbers: Uint32Array, at: number, more: number): number {
  const before = numbers[at] ?? 0;
  numbers[at] = before + more;
  return before;
}
