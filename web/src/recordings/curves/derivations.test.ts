import { describe, expect, it } from "vitest";
import { derivationOf, derivationText } from "./derivation_text";
import { evaluatorOf } from "./derivations";
import type { Value } from "../decoding/decoder";

const SECOND = 1_000_000_000n;

/** The values of a curve at messages, one every second. */
function curve(text: string, messages: readonly (Value | null)[], times = messages.map((_, number) => BigInt(number) * SECOND)): (number | null)[] {
  const evaluate = evaluatorOf(text);
  return messages.map((message, number) => evaluate(message, times[number] ?? 0n));
}

describe("computed curves", () => {
  it("have texts from which they are read again, whatever the names of fields", () => {
    const parts = ['odd["a,b;c!d)"]', "x"];
    expect(derivationOf(derivationText({ name: "difference", parts }))).toEqual({ name: "difference", parts });
    expect(["x", "norm", 'norm["(x)"]', "norms(x)", "derivative(x"].map(derivationOf)).toEqual([null, null, null, null, null]);
  });

  it("are fields where the text is a path", () => {
    expect(curve("a.x", [{ a: { x: 3 } }, { a: {} }, null])).toEqual([3, null, null]);
  });

  it("are the norms of vectors with two to four components", () => {
    expect(curve("norm(a)", [{ a: { x: 3, y: 4 } }, { a: { x: 1, y: 2, z: 2 } }, { a: { x: 1, y: 1, z: 1, w: 1 } }])).toEqual([5, 3, 2]);
    expect(curve("norm()", [{ x: 6, y: 8, other: 9 }])).toEqual([10]);
    expect(curve("norm(a)", [{ a: [3, 4] }, { a: Float32Array.of(1, 2, 2) }, { a: new Float64Array(5) }])).toEqual([5, 3, null]);
  });

  it("have no norm where a component is missing or no number", () => {
    expect(curve("norm(a)", [{ a: { x: 1 } }, { a: { x: 1, y: NaN } }, { a: { x: 1, y: 2, z: "3" } }, { a: 7 }, {}, null])).toEqual([null, null, null, null, null, null]);
  });

  it("are changes per second since the previous message", () => {
    const times = [0n, SECOND / 2n, 2n * SECOND];
    expect(curve("derivative(x)", [{ x: 1 }, { x: 2 }, { x: -1 }], times)).toEqual([null, 2, -2]);
  });

  it("are exact where times are large numbers of nanoseconds", () => {
    const start = 1_700_000_000_123_456_789n;
    expect(curve("derivative(x)", [{ x: 0 }, { x: 1 }], [start, start + 2_500_001n])).toEqual([null, 1 / (2_500_001 / 1e9)]);
  });

  it("have no derivative after what is missing, and where time does not go on", () => {
    expect(curve("derivative(x)", [{ x: 1 }, null, { x: 2 }, { x: 4 }])).toEqual([null, null, null, 2]);
    expect(curve("derivative(x)", [{ x: 1 }, { x: 2 }, { x: 4 }], [5n, 5n, 4n])).toEqual([null, null, null]);
  });

  it("are differences of two fields of a message", () => {
    expect(curve("difference(a.x,b)", [{ a: { x: 5 }, b: 2 }, { b: 2 }, { a: { x: 1 }, b: true }])).toEqual([3, null, 0]);
  });
});
