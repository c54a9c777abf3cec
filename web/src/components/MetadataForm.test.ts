import { mount } from "@vue/test-utils";
import { expect, test } from "vitest";
import { defineComponent, h, ref } from "vue";
import MetadataForm from "./MetadataForm.vue";
import { beginning, type Values } from "./metadata";
import type { MetadataFields } from "@/api/types";

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
