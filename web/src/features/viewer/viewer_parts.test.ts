import { mount } from "@vue/test-utils";
import { expect, it, vi } from "vitest";
import { ref } from "vue";
import { createMemoryHistory, createRouter } from "vue-router";
import EventsSide from "./EventsSide.vue";
import TimeGroupSelect from "./TimeGroupSelect.vue";
import { timeGroups } from "./time_groups";
import type { ViewerEvents } from "./useViewerEvents";

const NOW = 1_790_000_000_000_000_000n;
const recording = (key: string, fromNs: bigint) => ({ key, name: key, files: [{ id: key, path: key, format: "mcap" as const, size_bytes: 1, span: { fromNs, toNs: fromNs + 10n } }] });

async function routerAt(path: string) {
  const router = createRouter({ history: createMemoryHistory(), routes: [{ path: "/view", component: { template: "<i/>" } }] });
  await router.push(path);
  return router;
}

it("goes to another time axis by the address, without the loop", async () => {
  const router = await routerAt("/view?t=1790000000000000005&from=1790000000000000001&to=1790000000000000009&p=x");
  const groups = timeGroups({ recordings: [recording("boot", 5n), recording("drive", NOW)], topics: [] });
  const [, group] = groups;
  if (group === undefined) throw new Error("one group");
  const select = mount(TimeGroupSelect, { props: { groups, group }, global: { plugins: [router] } }).get("select");
  expect(select.element.value).toBe("1");
  expect(select.findAll("option").map((option) => option.text())).toEqual(["Recorded on 1970-01-01 (1 recording)", "Recorded on 2026-09-21 (1 recording)"]);
  await select.setValue("0");
  await vi.waitFor(() => expect(router.currentRoute.value.query).toEqual({ t: "5", p: "x" }));
});

it("begins and ends a span without keys", async () => {
  const begunNs = ref<number | null>(null);
  const list = { value: [] };
  const end = vi.fn();
  const state = {
    missionId: "m", mayAdd: ref(true), begunNs, begin: () => (begunNs.value = 7), end, error: ref(null), right: ref("WRITE"), events: list, findings: list,
    isLoading: ref(false), timeText: String,
  } as unknown as ViewerEvents;
  const view = mount(EventsSide, { props: { state, files: [] }, global: { plugins: [await routerAt("/view")], stubs: { EventsTable: true } } });
  const button = view.get("[data-span]");
  await button.trigger("click");
  expect(view.get("[data-begun]").text()).toContain("A span begins at 7");
  await view.get("[data-span]").trigger("click");
  expect(end).toHaveBeenCalledOnce();
});
