// The logic behind the page of a project: its fields as they are typed, its statistics as they are shown and saved.
import { describe, expect, it } from "vitest";
import {
  comparison,
  draftsOf,
  emptyDraft,
  fieldColumns,
  fieldsOf,
  moved,
  operatorsOf,
  readRefusal,
  sortOf,
  defaultFields,
  valueText,
  validateDrafts,
} from "./fields";
import { isForbidden, isolations } from "./isolation";
import { barsOf, csvOf, type Overview, type StatsRow } from "./queries";
import type { MetadataField, MetadataFields, Mission } from "@/api/types";
import { Problem } from "@/api/problem";

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
  const wrong = validateDrafts([{ ...robot, choices: " \n" }, { ...speed, name: "Robot" }, emptyDraft(), { ...emptyDraft(), name: "1st" }]);
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
  expect(bars.map(({ label, share }) => [label, share])).toEqual([["0 – 5 m/s", 0.5], ['=1+"1"', 1], ["All others", 0.25], ["Not set", 0.25]]);
  expect(csvOf(bars, overview.total).split("\n")[2]).toBe(`"'=1+""1""",1,2,1,4,5,7`);
});

function refused(code: "name_taken" | "invalid_request" | "metadata_invalid" | "forbidden", ...fields: string[]): Problem {
  const problems = fields.map((field) => ({ field, message: `${field} is wrong` }));
  return new Problem(code, 422, "x", "It is refused.", null, { problems });
}

const SHOWN = new Set(["robot", "place"]);

describe("what is said beside each field when a mission is refused", () => {
  it("is nothing before it is", () => {
    expect(readRefusal(null, SHOWN)).toEqual({ name: "", metadata: [], isElsewhere: false });
  });
  it("is what is wrong with the name", () => {
    expect(readRefusal(refused("name_taken"), SHOWN)).toEqual({ name: "It is refused.", metadata: [], isElsewhere: false });
    expect(readRefusal(refused("invalid_request", "body.name"), SHOWN)).toMatchObject({ name: "body.name is wrong", isElsewhere: false });
  });
  it("is what is wrong with the metadata, a part of a place too, and never the name's", () => {
    const refusal = readRefusal(refused("metadata_invalid", "robot", "place.latitude"), SHOWN);
    expect(refusal).toMatchObject({ name: "", isElsewhere: false });
    expect(refusal.metadata.map(({ field }) => field)).toEqual(["robot", "place.latitude"]);
    expect(readRefusal(refused("metadata_invalid", "name"), new Set(["name"]))).toMatchObject({ name: "", isElsewhere: false });
  });
  it("is said above all where no field shows it", () => {
    expect(readRefusal(refused("metadata_invalid", "robot", "surplus"), SHOWN).isElsewhere).toBe(true);
    expect(readRefusal(refused("invalid_request", "body.notes"), SHOWN).isElsewhere).toBe(true);
    expect(readRefusal(refused("forbidden"), SHOWN).isElsewhere).toBe(true);
  });
});

function field(name: string, type: MetadataField["type"], more: Partial<MetadataField> = {}): MetadataField {
  return { name, type, required: false, description: "", ...more };
}

it("makes a column of each field, sorted by the server, with its unit", () => {
  const columns = fieldColumns([field("robot", "choice"), field("temperature", "number", { unit: "degC" })]);
  const mission = { metadata: { robot: "spot", temperature: 9.5 } } as unknown as Mission;
  expect(columns.map((column) => [column.key, column.sort, column.text?.(mission)])).toEqual([
    ["meta.robot", "meta.robot", "spot"], ["meta.temperature", "meta.temperature", "9.5 degC"],
  ]);
});

it("shows required fields first until somebody chooses", () => {
  const fields = [field("a", "string"), field("b", "string", { required: true }), field("c", "string"), field("d", "string")];
  expect(defaultFields(fields)).toEqual(["meta.b", "meta.a"]);
});

it("writes places, lists and missing values as text", () => {
  expect([{ latitude: 1, longitude: 2 }, { name: "Zürich" }, ["a", 1], true, undefined].map((value) => valueText(value))).toEqual(["1, 2", "Zürich", "a, 1", "yes", ""]);
});

it("compares text as text, numbers as numbers, and parts of text", () => {
  expect(comparison(field("robot", "choice"), "=", "7")).toBe('robot="7"');
  expect(comparison(field("temperature", "number"), ">=", "9.5")).toBe("temperature>=9.5");
  expect(comparison(field("site", "string"), "~", "zür")).toBe("site~*zür*");
  expect(operatorsOf("date")[0]).toBe(">=");
  expect(operatorsOf("location")).toEqual(["~"]);
});

it("takes no order from the address that the server does not know", () => {
  expect(["meta.robot", "-meta.site.name", "-verdict", "size", "meta.", "x"].map(sortOf)).toEqual([
    "meta.robot", "-meta.site.name", "-verdict", "-start", "-start", "-start",
  ]);
});

it("forbids the classes of isolation that are weaker than the server allows", () => {
  const forbidden = (weakest: (typeof isolations)[number]) => isolations.filter((item) => isForbidden(item, weakest));
  expect([forbidden("container"), forbidden("namespaces"), forbidden("none")]).toEqual([["namespaces", "none"], ["none"], []]);
});
