import { mount } from "@vue/test-utils";
import { expect, it } from "vitest";
import { effectScope, nextTick, ref } from "vue";
import { createMemoryHistory, createRouter } from "vue-router";
import { useClock } from "./clock";
import LogPanel from "./panels/LogPanel.vue";
import { panelOf } from "./layout";
import { Sources } from "./sources";
import { useAddress, type ViewerAddress } from "./useAddress";
import { viewerKey } from "./viewer";

const SPAN = { fromNs: 0n, toNs: 100n };

function clockOf() {
  const clock = effectScope().run(() => useClock(SPAN, [SPAN], 0n));
  if (clock === undefined) throw new Error("no clock");
  return clock;
}

it("has the same panels while only the time in the address changes", async () => {
  const router = createRouter({ history: createMemoryHistory(), routes: [{ path: "/", component: { template: "<i/>" } }] });
  await router.push({ path: "/", query: { t: "1", p: ["raw:k@/a", "raw:k@/b"] } });
  const made: ViewerAddress[] = [];
  mount({ setup: () => void made.push(useAddress(clockOf(), () => [])), template: "<i/>" }, { global: { plugins: [router] } });
  const { panels } = made[0] as ViewerAddress;
  const before = panels.value;
  expect(before).toHaveLength(2);
  await router.push({ path: "/", query: { t: "2", p: ["raw:k@/a", "raw:k@/b"] } });
  expect(panels.value).toBe(before);
  await router.push({ path: "/", query: { t: "2", p: ["raw:k@/b"] } });
  expect(panels.value.map(({ series }) => series[0]?.topic)).toEqual(["/b"]);
});

it("shows the filter of the log that the address has, also after it changed", async () => {
  const viewer = { clock: clockOf(), sources: new Sources([], () => { throw new Error("not needed"); }), topics: [], selected: ref(0) };
  const panel = (filter: string) => panelOf(`log:k@/log,${filter}`);
  const wrapper = mount(LogPanel, { props: { panel: panel("warning,motor"), priority: 0 } as never, global: { provide: { [viewerKey as symbol]: viewer } } });
  const input = () => wrapper.get("input").element.value;
  expect(input()).toBe("motor");
  await wrapper.setProps({ panel: panel("warning") } as never);
  await nextTick();
  expect(input()).toBe("");
  await wrapper.get("input").setValue("brake");
  await wrapper.get("input").trigger("change");
  expect(wrapper.emitted("update")?.at(-1)).toEqual([panel("warning,brake")]);
});
