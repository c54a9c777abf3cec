// The logic behind the page of a project: its fields as they are typed, its statistics as they are shown and saved.
import { expect, it } from "vitest";
import { draftsOf, emptyDraft, fieldsOf, moved, wrongWith } from "./fields";
import type { Overview, StatsRow } from "./queries";
import { barsOf, csvOf } from "./stats";
import type { MetadataFields } from "@/api/types";

const fields: MetadataFields = {
  undeclared: "refuse",
  fields: [
    { name: "robot", type: "choice", required: true, description: "Which", choices: ["a", "b"] },
    { name: "speed", type: "number", required: false, description: "", unit: "m/s", default: 3 },
  ],
};

it("gives fields back as they were, and drops what belongs to another type", () => {
  expect(fieldsOf(draftsOf(fields), true)).toEqual(fields);
  const drafts = draftsOf(fields).map((draft) => ({ ...draft, type: "string" as const }));
  expect(fieldsOf(drafts, false)).toEqual({
    undeclared: "accept",
    fields: [{ name: "robot", type: "string", required: true, description: "Which" }, { name: "speed", type: "string", required: false, description: "" }],
  });
});

it("says what is wrong beside the field", () => {
  const [robot, speed] = draftsOf(fields);
  if (robot === undefined || speed === undefined) throw new Error("two fields were given");
  const wrong = wrongWith([{ ...robot, choices: " \n" }, { ...speed, name: "Robot" }, emptyDraft(), { ...emptyDraft(), name: "1st" }]);
  expect([...wrong.keys()].map((key) => key.split(" ")[1])).toEqual(["choices", "name", "name", "name"]);
  expect(moved([robot, speed], 0, 1).map(({ name }) => name)).toEqual(["speed", "robot"]);
  expect(moved([robot, speed], 0, -1).map(({ name }) => name)).toEqual(["robot", "speed"]);
});

function row(duration_h: number): StatsRow {
  return { group: null, missions: 1, files: 2, recordings: 1, size_bytes: 5, duration_ns: duration_h * 3.6e12, messages: 7 };
}

it("shows groups with what is left and what says nothing last, and saves no formulas", () => {
  const overview: Overview = {
    by: "metadata.speed", unit: "m/s", topics: 3, total: row(6), other: row(1),
    buckets: [{ value: null, low: null, high: null, stats: row(1) }, { value: null, low: 0, high: 5, stats: row(2) }, { value: '=1+"1"', low: null, high: null, stats: row(4) }],
  };
  const bars = barsOf(overview, "duration_ns");
  expect(bars.map(({ label, share }) => [label, share])).toEqual([["0 – 5 m/s", 0.5], ['=1+"1"', 1], ["all others", 0.25], ["not set", 0.25]]);
  expect(csvOf(bars, overview.total).split("\n")[2]).toBe(`"'=1+""1""",1,2,1,4,5,7`);
});
