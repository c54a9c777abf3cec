import { describe, expect, it } from "vitest";
import { cellOf, cellText, columnsOf, offeredColumns, ROWS_BEFORE, ROWS_BEHIND, rowsAround, rowsCsv, validPlace, windowAround } from "./table_rows";

const VALUE = { header: { stamp: 1.5, frame_id: "base" }, name: "a, \"b\"", pose: { x: 0.1, y: null }, flags: [true, false] };
const rows = Array.from({ length: 300 }, (_, number) => ({ timeNs: BigInt(number * 10), value: { n: number } }));

describe("a table", () => {
  it("reads about as many messages around a time as it has rows", () => {
    const { fromNs, toNs } = windowAround(5_000_000_000n, { fromNs: 0n, toNs: 10_000_000_000n }, 101);
    expect([fromNs, toNs]).toEqual([5_000_000_000n - BigInt(ROWS_BEFORE) * 100_000_000n, 5_000_000_000n + BigInt(ROWS_BEHIND) * 100_000_000n]);
    expect(windowAround(0n, { fromNs: 0n, toNs: 1n }, 1_000_000_000).toNs).toBe(50_000_000n);
    expect(windowAround(0n, { fromNs: 0n, toNs: 10n ** 18n }, 2).toNs).toBe(3_600_000_000_000n);
  });

  it("marks the last row at or before a time, and shows those around it", () => {
    expect([validPlace(rows, -1n), validPlace(rows, 0n), validPlace(rows, 19n), validPlace(rows, 10_000n)]).toEqual([-1, 0, 1, 299]);
    const shown = rowsAround(rows, 1_005n);
    expect([shown[0]?.timeNs, shown.at(-1)?.timeNs, shown.length]).toEqual([700n, 1_600n, ROWS_BEFORE + ROWS_BEHIND + 1]);
  });

  it("offers every value as a column, and begins with those that are no header", () => {
    const offered = offeredColumns(VALUE);
    expect(columnsOf(offered, [])).toEqual(["name", "pose.x", "pose.y", "flags[0]", "flags[1]"]);
    expect(columnsOf(offered, ["header.frame_id", "gone"])).toEqual(["header.frame_id"]);
    expect(columnsOf(offeredColumns({ header: { seq: 1 } }), [])).toEqual(["header.seq"]);
  });

  it("copies times and values with every digit", () => {
    const row = { timeNs: 1_700_000_000_123_456_789n, value: { ...VALUE, pose: { x: 0.123456789012345, y: null } } };
    expect(cellText(cellOf(row, "pose.x"))).toBe("0.1234568");
    expect(cellText(cellOf(row, "pose.z"))).toBe("");
    expect(rowsCsv([row], ["name", "pose.x", "pose.y", "flags[0]"])).toBe('log_time_ns,name,pose.x,pose.y,flags[0]\n1700000000123456789,"a, ""b""",0.123456789012345,,true\n');
  });
});
