import { expect, it } from "vitest";
import { computed, effectScope, nextTick, shallowRef } from "vue";
import { useFirstData, type ViewerData } from "./queries";

const dataOf = (...ids: string[]): ViewerData => ({
  recordings: ids.map((id) => ({ key: id, name: id, files: [{ id, path: id, format: "mcap", size_bytes: 1, span: { fromNs: 0n, toNs: 1n } }] })),
  topics: ids.map((recording) => ({ recording, name: "/t", messageType: null, count: 1, firstNs: 0, density: [] })),
});

function viewing(start: ViewerData | null, isComplete = () => true) {
  const loaded = shallowRef(start);
  const viewed = effectScope().run(() => useFirstData(computed(() => loaded.value), isComplete));
  if (viewed === undefined) throw new Error("no scope");
  return { loaded, ...viewed };
}

it("keeps what it began with after an upload, until it is reloaded", async () => {
  const { loaded, first, isChanged, reloads, reload } = viewing(null);
  loaded.value = dataOf("a");
  await nextTick();
  const before = first.value;
  loaded.value = dataOf("a", "b");
  await nextTick();
  expect([first.value === before, isChanged.value, reloads.value]).toEqual([true, true, 1]);
  reload();
  expect([first.value?.recordings.length, isChanged.value, reloads.value]).toEqual([2, false, 2]);
});

it("shows no notice where the same was loaded again", async () => {
  const { loaded, isChanged } = viewing(dataOf("a"));
  loaded.value = dataOf("a");
  await nextTick();
  expect(isChanged.value).toBe(false);
});

it("begins with the first recordings of an empty mission", async () => {
  const { loaded, first, isChanged } = viewing(dataOf());
  loaded.value = dataOf("a");
  await nextTick();
  expect([first.value?.recordings.length, isChanged.value]).toEqual([1, false]);
});

it("begins again where all recordings were deleted", async () => {
  const { loaded, first, reload } = viewing(dataOf("a"));
  loaded.value = dataOf();
  reload();
  loaded.value = dataOf("b");
  await nextTick();
  expect(first.value?.recordings.map(({ key }) => key)).toEqual(["b"]);
});

it("follows what is loaded until the server has read all files", async () => {
  let isComplete = false;
  const { loaded, first, isChanged, reloads } = viewing(dataOf("a"), () => isComplete);
  loaded.value = dataOf("a");
  await nextTick();
  expect(reloads.value).toBe(1);
  isComplete = true;
  loaded.value = dataOf("a", "b");
  await nextTick();
  expect([first.value?.recordings.length, isChanged.value, reloads.value]).toEqual([2, false, 2]);
  loaded.value = dataOf("a", "b", "c");
  await nextTick();
  expect([first.value?.recordings.length, isChanged.value, reloads.value]).toEqual([2, true, 2]);
});
