import { mount } from "@vue/test-utils";
import { afterEach, beforeEach, expect, test, vi } from "vitest";
import SearchBox from "./SearchBox.vue";

beforeEach(() => vi.useFakeTimers());
afterEach(() => vi.useRealTimers());

function box(text: string) {
  const wrapper = mount(SearchBox, { props: { modelValue: text, wrong: null } });
  const input = wrapper.get<HTMLInputElement>("input");
  const lastQuery = () => wrapper.emitted<[string]>("update:modelValue")?.at(-1)?.[0];
  return { wrapper, input, lastQuery };
}

test("what is typed while the address changes stays", async () => {
  const { wrapper, input, lastQuery } = box("");
  await input.setValue("alp");
  vi.advanceTimersByTime(350);
  expect(lastQuery()).toBe("alp");
  await input.setValue("alps");
  await wrapper.setProps({ modelValue: "alp" }); // only now it has changed
  expect(input.element.value).toBe("alps");
  vi.advanceTimersByTime(350);
  expect(lastQuery()).toBe("alps");
});

test("a text that comes from elsewhere takes the place of what was typed", async () => {
  const { wrapper, input, lastQuery } = box("alps");
  await input.setValue("alps lakes");
  await wrapper.setProps({ modelValue: "alps format:mcap" });
  expect(input.element.value).toBe("alps format:mcap");
  vi.advanceTimersByTime(350);
  expect(lastQuery()).toBeUndefined();
});

test("going back to what was asked before is seen", async () => {
  const { wrapper, input } = box("alps");
  await input.setValue("lakes");
  vi.advanceTimersByTime(350);
  await wrapper.setProps({ modelValue: "lakes" });
  await wrapper.setProps({ modelValue: "alps" });
  expect(input.element.value).toBe("alps");
});
