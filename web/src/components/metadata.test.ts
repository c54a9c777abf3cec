import { describe, expect, it, test } from "vitest";
import { beginning, changes, validateValues, validateField, shownValue, undeclared, type Values } from "./metadata";
import type { MetadataField, MetadataFields } from "@/api/types";
import { texts } from "@/texts/metadata";
import { mount } from "@vue/test-utils";
import { defineComponent, h, ref } from "vue";
import MetadataForm from "./MetadataForm.vue";

function field(type: MetadataField["type"], more: Partial<MetadataField> = {}): MetadataField {
  return { name: "it", type, required: false, description: "", ...more };
}

describe("one field", () => {
  it.each([
    [field("number"), 0, null],
    [field("number", { unit: "degC" }), "warm", texts.wantsNumber("degC")],
    [field("number"), Number.NaN, texts.wantsNumber("")],
    [field("boolean"), false, null],
    [field("boolean"), "false", texts.wantsBoolean],
    [field("date"), "2024-05-31", null],
    [field("date"), "2024-05-31T14:00Z", null],
    [field("date"), "31.5.2024", texts.wantsDate],
    [field("date"), "2024-13-31", texts.wantsDate],
    [field("link"), "https://example.org/x", null],
    [field("link"), "javascript:alert(1)", texts.wantsLink],
    [field("choice", { choices: ["a", "b"] }), "b", null],
    [field("choice", { choices: ["a", "b"] }), "c", texts.wantsChoice],
    [field("location"), "Zürich", null],
    [field("location"), { latitude: 47.3, longitude: 8.5 }, null],
    [field("location"), { latitude: 97.3, longitude: 8.5 }, texts.wantsLatitude],
    [field("location"), { latitude: 47.3 }, texts.wantsLongitude],
    [field("string", { pattern: "[A-Z]{2}\\d+" }), "AB12", null],
    [field("string", { pattern: "[A-Z]{2}\\d+" }), "xAB12", texts.wantsPattern("[A-Z]{2}\\d+")],
    [field("string", { pattern: "(?x) a b" }), "whatever: the server judges", null],
  ] as const)("%o takes %o", (of, value, wrong) => expect(validateField(of, value)).toBe(wrong));

  it("may be empty unless it is required and has no default", () => {
    expect(validateField(field("number"), null)).toBeNull();
    expect(validateField(field("number", { required: true }), "")).toBe(texts.required);
    expect(validateField(field("number", { required: true, default: 3 }), "")).toBeNull();
  });
});

describe("a form", () => {
  const fields: MetadataFields = { undeclared: "accept", fields: [field("number", { name: "speed", required: true })] };
  it("names all that is wrong", () => expect(validateValues(fields, { other: 1 })).toEqual([{ field: "speed", message: texts.required }]));
  it("knows what nobody declared", () => expect(undeclared(fields, { speed: 1, other: 2 })).toEqual(["other"]));
  it("sends what changed, and null for what is to go", () => {
    expect(changes({ a: 1, b: "x", c: [1] }, { a: 1, b: "", c: [1, 2], d: false })).toEqual({ b: null, c: [1, 2], d: false });
    expect(changes({ a: { x: 1 } }, { a: { x: 1 } })).toEqual({});
  });
});

it("shows values as they are read", () => {
  expect(shownValue(12, "m")).toBe("12 m");
  expect(shownValue(null)).toBe("–");
  expect(shownValue(false)).toBe("No");
  expect(shownValue({ latitude: 47, longitude: 8, name: "Zürich" })).toBe("Zürich (47.00000°, 8.00000°)");
  expect(shownValue(["a"])).toBe('["a"]');
});

const FIELDS: MetadataFields = {
  undeclared: "accept",
  fields: ["robot", "site"].map((name) => ({ name, type: "string", required: true, unit: null, description: "", pattern: null, choices: null, default: null })),
};

/** A form that begins with what an earlier mission said, and was sent once. */
function form() {
  const begun = beginning({ site: "Bern" }, { from: "day 1", values: { robot: "spot", extra: 3 } });
  const values = ref<Values>(begun.values);
  const unconfirmed = ref(begun.unconfirmed);
  const wrapper = mount(defineComponent(() => () => h(MetadataForm, {
    fields: FIELDS, shown: true, carriedFrom: "day 1", modelValue: values.value, unconfirmed: unconfirmed.value,
    "onUpdate:modelValue": (value: Values) => (values.value = value),
    "onUpdate:unconfirmed": (names: ReadonlySet<string>) => (unconfirmed.value = names),
  })));
  const marked = () => wrapper.findAll("[data-unconfirmed]").map((item) => item.attributes("data-unconfirmed"));
  return { wrapper, values, unconfirmed, marked };
}

test("values of an earlier mission are marked, each by itself, with where they are from", () => {
  const { wrapper, marked } = form();
  expect(marked()).toEqual(["robot", "extra"]);
  expect(wrapper.get("[data-unconfirmed=robot]").text()).toContain("Copied from day 1, not confirmed");
  expect(wrapper.findAll("[aria-invalid=true]")).toHaveLength(2);
});

test("a value is confirmed by its button, and by changing it", async () => {
  const { wrapper, values, unconfirmed, marked } = form();
  await wrapper.get("[data-unconfirmed=robot] button").trigger("click");
  expect(marked()).toEqual(["extra"]);
  expect(values.value).toEqual({ site: "Bern", robot: "spot", extra: 3 });
  await wrapper.get<HTMLInputElement>(".further .line input").setValue("4");
  expect(marked()).toEqual([]);
  expect([...unconfirmed.value]).toEqual([]);
  expect(values.value).toMatchObject({ extra: 4 });
});

test("changing one value confirms no other", async () => {
  const { wrapper, marked } = form();
  await wrapper.findAll<HTMLInputElement>("input.input")[1]?.setValue("Chur");
  expect(marked()).toEqual(["robot", "extra"]);
});
