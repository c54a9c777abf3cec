import { describe, expect, it, vi } from "vitest";
import { BLOCK, MAX_READ_AT_ONCE } from "./limits";
import { storeOf } from "./testing/recordings";

const BYTES = Uint8Array.from({ length: 5 * BLOCK + 17 }, (_, at) => (at * 7 + (at >> 8)) & 255);

describe("Ranges", () => {
  it("gives the bytes asked for, across blocks and at the end", async () => {
    const { ranges } = storeOf(BYTES);
    const requests: [number, number][] = [[0, 10], [BLOCK - 3, 6], [2 * BLOCK, BLOCK], [BYTES.length - 20, 20], [0, BYTES.length]];
    for (const [offset, length] of requests) {
      const read = await ranges.read(offset, length);
      expect(read).toHaveLength(length);
      expect(read.every((byte, at) => byte === BYTES[offset + at])).toBe(true);
    }
    expect(ranges.bytesRead).toBe(BYTES.length);
  });

  it("asks once for neighbours, and not again for what it has", async () => {
    const { ranges, answers } = storeOf(BYTES);
    await ranges.read(10, 2 * BLOCK);
    await ranges.read(0, 3 * BLOCK);
    expect(answers).toEqual([3 * BLOCK]);
    await ranges.read(BLOCK, 4 * BLOCK);
    expect(answers).toEqual([3 * BLOCK, 2 * BLOCK]);
  });

  it("reads ahead where it is told to", async () => {
    const { ranges, answers } = storeOf(BYTES);
    ranges.ahead = 4 * BLOCK;
    await ranges.read(0, 1);
    expect(answers).toEqual([4 * BLOCK]);
  });

  it.each([[100, 3], [1_000, 2], [8_000, 1]])("reads ahead no more than comes within a second, where two blocks take %d ms", async (readingMs, blocks) => {
    let nowMs = 0;
    const { ranges, answers } = storeOf(BYTES, { now: () => (nowMs += readingMs) });
    await ranges.read(0, 2 * BLOCK);
    ranges.ahead = 3 * BLOCK;
    await ranges.read(2 * BLOCK, 1);
    expect(answers).toEqual([2 * BLOCK, blocks * BLOCK]);
  });

  it("fetches the next range while the one before it is used, once three came in order", async () => {
    const { ranges, answers } = storeOf(BYTES, { fetchesNext: true });
    for (const block of [0, 1, 2]) await ranges.read(block * BLOCK, BLOCK);
    await vi.waitFor(() => expect(answers).toEqual([BLOCK, BLOCK, BLOCK, BLOCK]));
    expect(ranges.bytesRead).toBe(3 * BLOCK);
    expect(await ranges.read(3 * BLOCK, 10)).toEqual(BYTES.slice(3 * BLOCK, 3 * BLOCK + 10));
    expect(ranges.bytesRead).toBe(4 * BLOCK);
    await vi.waitFor(() => expect(answers).toHaveLength(5));
    expect(await ranges.read(0, BYTES.length)).toEqual(BYTES);
    expect(answers.reduce((sum, length) => sum + length, 0)).toBe(BYTES.length);
  });

  it("fetches nothing ahead over a slow line", async () => {
    let nowMs = 0;
    const { ranges, answers } = storeOf(BYTES, { fetchesNext: true, now: () => (nowMs += 300) });
    for (const block of [0, 1, 2, 3]) await ranges.read(block * BLOCK, BLOCK);
    await vi.waitFor(() => expect(answers).toHaveLength(4));
  });

  it("fetches a range again that could not be fetched ahead", async () => {
    const { ranges, answers, change } = storeOf(BYTES, { fetchesNext: true });
    for (const block of [0, 1]) await ranges.read(block * BLOCK, BLOCK);
    const third = ranges.read(2 * BLOCK, BLOCK);
    await vi.waitFor(() => expect(answers).toHaveLength(3));
    change(BYTES.slice().fill(0));
    await third;
    await expect(ranges.read(3 * BLOCK, 1)).rejects.toMatchObject({ code: "file_changed" });
  });

  it("asks for another address when one expires, by the clock or by the store's word", async () => {
    const soon = storeOf(BYTES, { lifeMs: 1000 });
    await soon.ranges.read(0, 1);
    await soon.ranges.read(BLOCK, 1);
    expect(soon.renewals()).toBe(2);
    const refused = storeOf(BYTES);
    await refused.ranges.read(0, 1);
    refused.expire();
    expect(await refused.ranges.read(BLOCK, 1)).toEqual(BYTES.slice(BLOCK, BLOCK + 1));
    expect(refused.renewals()).toBe(2);
  });

  it("notices that the file is another one now", async () => {
    const { ranges, change } = storeOf(BYTES);
    await ranges.read(0, 1);
    change(BYTES.slice().fill(0));
    await expect(ranges.read(BLOCK, 1)).rejects.toMatchObject({ code: "file_changed" });
  });

  it("refuses what is outside of the file, and more than it holds at once", async () => {
    const { ranges } = storeOf(BYTES);
    for (const [offset, length] of [[-1, 2], [0, BYTES.length + 1], [NaN, 1], [1, -1]] as const) {
      await expect(ranges.read(offset, length)).rejects.toMatchObject({ code: "index_damaged" });
    }
    const large = storeOf(new Uint8Array(MAX_READ_AT_ONCE + BLOCK));
    await expect(large.ranges.read(0, MAX_READ_AT_ONCE + 1)).rejects.toMatchObject({ code: "too_large" });
  });

  it("requests a range again that the network interrupted, a few times", async () => {
    vi.useFakeTimers();
    const { ranges, interrupt } = storeOf(BYTES);
    interrupt(3);
    const read = ranges.read(0, 1);
    await vi.runAllTimersAsync();
    expect(await read).toEqual(BYTES.slice(0, 1));
    interrupt(4);
    const refused = expect(ranges.read(BLOCK, 1)).rejects.toMatchObject({ code: "store_unreachable" });
    await vi.runAllTimersAsync();
    await refused;
    vi.useRealTimers();
  });

  it("ends when it is told to", async () => {
    const { ranges } = storeOf(BYTES);
    ranges.signal = AbortSignal.abort();
    await expect(ranges.read(0, 1)).rejects.toMatchObject({ code: "cancelled" });
  });
});
