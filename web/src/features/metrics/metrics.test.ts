import { describe, expect, it } from "vitest";
import type { MetricTable } from "./queries";
import { columnChoices, differenceText, isWholeTable, numberText, outcomeOf, queryOf, tableCommands, toggled, type Address } from "./tables";

const ADDRESS: Address = {
  metric: "ate", project: "", mission: "", rows: "mission", columns: ["action", "version"], aggregate: "median", better: "", query: "", where: [],
  action: "", version: "", topic: "", first: "", second: "", all: "",
};

describe("the query of a table", () => {
  it("is that of its address", () => {
    expect(queryOf({ ...ADDRESS, metric: "" })).toBeNull();
    expect(queryOf(ADDRESS)).toEqual({ metric: "ate", rows: "mission", columns: ["action", "version"], aggregate: "median" });
    expect(queryOf({ ...ADDRESS, project: "p", version: "2", first: "a@1", second: "a@2", better: "lower", all: "yes", where: ["x=1"] })).toMatchObject({
      project_id: "p", version: 2, compare: ["a@1", "a@2"], better: "lower", all_rows: true, where: ["x=1"],
    });
  });
  it("leaves out what the server would not take", () => {
    expect(queryOf({ ...ADDRESS, aggregate: "sum", better: "up", version: "x", first: "a@1" })).toEqual(queryOf(ADDRESS));
  });
  it("has at least one column", () => {
    expect(toggled(["action", "version"], "topic")).toEqual(["action", "version", "topic"]);
    expect(toggled(["action", "version"], "action")).toEqual(["version"]);
    expect(toggled(["version"], "version")).toEqual(["version"]);
  });
  it("offers the columns in which results differ, and those that are chosen", () => {
    const table = { dimensions: [{ name: "param.method", value_count: 2 }] } as unknown as MetricTable;
    expect(columnChoices(table, ["label.kind"])).toEqual(["action", "version", "topic", "param.method", "label.kind"]);
    expect(columnChoices(undefined, [])).toEqual(["action", "version", "topic"]);
  });
  it("is a command, too, with what was typed in quotes", () => {
    const query = queryOf({ ...ADDRESS, rows: "metadata.robot", action: "slam", version: "2", where: ["param.x=it's"], first: "a@1", second: "a b", project: "id" });
    const { cli, sdk } = tableCommands(query ?? { metric: "" });
    expect(cli).toBe(
      "klein metrics table --metric ate --rows robot --columns action,version --aggregate median --project id --where 'param.x=it'\\''s' --action slam@2 --compare a@1 'a b'",
    );
    expect(sdk).toContain(`client.metrics.table("ate", rows="robot", columns=["action","version"], aggregate="median", project="id", where=["param.x=it's"], action="slam", version=2`);
  });
});

describe("numbers", () => {
  it("have four significant digits, as on the command line", () => {
    expect([0.012345, 12345.678, 3, -0.5, 0, 1e-9, 9.99999].map((value) => numberText(value, false))).toEqual([
      "0.01235", "12346", "3.000", "-0.5000", "0", "1.000e-9", "10.00",
    ]);
    expect(numberText(12, true)).toBe("12");
  });
  it("of a difference have a sign", () => {
    expect([0.5, -0.5, 0].map((value) => differenceText(value, false))).toEqual(["+0.5000", "−0.5000", "0"]);
  });
  it("are whole where all of a table are", () => {
    const table = (...values: readonly (number | null)[]) => ({ rows: [{ cells: values.map((value) => ({ value })) }] }) as unknown as MetricTable;
    expect([isWholeTable(table(1, null, 2)), isWholeTable(table(1, 2.5))]).toEqual([true, false]);
  });
});

describe("a comparison", () => {
  it("is won by the better value", () => {
    expect([-1, 1, 0].map((difference) => outcomeOf(difference, "lower"))).toEqual(["win", "loss", "tie"]);
    expect([-1, 1, 0].map((difference) => outcomeOf(difference, "higher"))).toEqual(["loss", "win", "tie"]);
    expect(outcomeOf(1, "none")).toBeNull();
  });
});
