import { mount } from "@vue/test-utils";
import { expect, it } from "vitest";
import { nextTick } from "vue";
import { createMemoryHistory, createRouter } from "vue-router";
import { discardOnNavigation, useQueryList, useQueryText } from "./query";

async function page(at: string) {
  const router = createRouter({ history: createMemoryHistory(), routes: [{ path: "/:path(.*)*", component: { template: "<i/>" } }] });
  discardOnNavigation(router);
  await router.push(at);
  const view = mount(
    { setup: () => ({ text: useQueryText("q"), sort: useQueryText("sort", "name"), topics: useQueryList("topic") }), template: "<i/>" },
    { global: { plugins: [router] } },
  ).vm as unknown as { text: string; sort: string; topics: readonly string[] };
  const settled = async () => {
    await nextTick();
    await new Promise((resolve) => setTimeout(resolve));
    return router.currentRoute.value.fullPath;
  };
  return { view, settled, router };
}

it("reads the address", async () => {
  const { view } = await page("/x?q=a&topic=/imu&topic=/odom");
  expect([view.text, view.sort, view.topics]).toEqual(["a", "name", ["/imu", "/odom"]]);
});

it("writes several parts at once, and leaves out what says nothing", async () => {
  const { view, settled } = await page("/x?q=a&keep=1");
  view.text = "";
  view.sort = "-created";
  view.topics = ["/imu"];
  expect(await settled()).toBe("/x?keep=1&sort=-created&topic=/imu");
  view.sort = "name";
  expect(await settled()).toBe("/x?keep=1&topic=/imu");
});

it("does not follow to another page", async () => {
  const { view, settled, router } = await page("/x");
  view.text = "late";
  await router.push("/y");
  expect(await settled()).toBe("/y");
});

it("keeps a change that the router has not applied yet", async () => {
  const { view, settled, router } = await page("/x");
  let apply = (): void => undefined;
  router.beforeEach(() => new Promise<void>((resolve) => (apply = resolve)));
  view.text = "first";
  await settled();
  view.sort = "second";
  const applyFirst = apply;
  await settled();
  applyFirst();
  apply();
  await settled();
  expect(await settled()).toBe("/x?q=first&sort=second");
});
