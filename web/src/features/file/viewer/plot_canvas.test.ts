import { mount } from "@vue/test-utils";
import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { nextTick } from "vue";
import PlotCanvas from "./PlotCanvas.vue";

/** A context that draws nothing. */
const context = new Proxy({}, { get: () => () => ({ width: 8 }), set: () => true });

beforeEach(() => {
  vi.spyOn(HTMLCanvasElement.prototype, "getContext").mockReturnValue(context as unknown as null);
  vi.spyOn(HTMLElement.prototype, "clientWidth", "get").mockReturnValue(600);
  vi.stubGlobal("Path2D", vi.fn(function path() { return context; }));
});
afterEach(() => vi.unstubAllGlobals());

async function settled(): Promise<void> {
  for (let turn = 0; turn < 5; turn += 1) await nextTick();
}

it("stays enlarged when it is made anew for further curves, before their values are shown", async () => {
  const plot = mount(PlotCanvas, { props: { names: ["x"], seconds: [0, 5, 10], values: [[1, 2, 3]], label: "", span: [0, 10], head: 1, zoom: [4, 6] }, attachTo: document.body });
  const isHeadVisible = (): boolean => plot.get<HTMLElement>(".mark").element.style.visibility === "visible";
  await settled();
  expect(isHeadVisible()).toBe(false);
  await plot.setProps({ names: ["x", "y"], seconds: [0, 4, 10], values: [[1, 2, 3], [4, 5, 6]] });
  await settled();
  expect(isHeadVisible()).toBe(false);
  await plot.setProps({ head: 5 });
  expect(isHeadVisible()).toBe(true);
  expect(plot.emitted("zoom")).toBeUndefined();
  plot.unmount();
});
