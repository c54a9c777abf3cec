import { expect, it } from "vitest";
import { comparison, fieldColumns, operatorsOf, sortOf, usualFields, valueText } from "./metadata_columns";
import type { MetadataField, Mission } from "@/api/types";

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
  expect(usualFields(fields)).toEqual(["meta.b", "meta.a"]);
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
  expect(["meta.robot", "-meta.site.name", "-start", "size", "meta.", "x"].map(sortOf)).toEqual([
    "meta.robot", "-meta.site.name", "-start", "-start", "-start", "-start",
  ]);
});
