import { mount } from "@vue/test-utils";
import { expect, test } from "vitest";
import ColumnChooser from "./ColumnChooser.vue";

test("a click on a box changes that column alone, also where columns of another time are remembered", async () => {
  const columns = ["by", "took"].map((key) => ({ key, title: key }));
  const wrapper = mount(ColumnChooser, { props: { columns, modelValue: ["metric.of_another_list", "by"] } });
  const [by, took] = wrapper.findAll("input");
  await took?.trigger("change");
  await by?.trigger("change");
  expect(wrapper.emitted("update:modelValue")).toEqual([[["metric.of_another_list", "by", "took"]], [["metric.of_another_list", "took"]]]);
});
