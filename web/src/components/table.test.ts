import { describe, expect, it, test } from "vitest";
import { afterClick, columnsFor, drawnAfter, inSight, nextSort, placesOf, rowAfter, sortedAs, tracks } from "./table";
import { mount } from "@vue/test-utils";
import ColumnChooser from "./ColumnChooser.vue";

const columns = [
  { key: "name", title: "Name", sort: "name" },
  { key: "size", title: "Size", from: "tablet" as const, width: "100px" },
  { key: "by", title: "By", from: "desktop" as const },
];

describe("columns", () => {
  it("leaves out what there is no room for", () => {
    expect(columnsFor(columns, 360).map((item) => item.key)).toEqual(["name"]);
    expect(columnsFor(columns, 700).map((item) => item.key)).toEqual(["name", "size"]);
    expect(columnsFor(columns, 1200)).toHaveLength(3);
  });
  it("leaves out those that have no room, the last ones first", () => {
    const many = Array.from({ length: 8 }, (_, at) => ({ key: String(at), title: "", width: "minmax(150px, 1fr)", ...(at > 0 && { from: "tablet" as const }) }));
    expect(columnsFor(many, 800).map((item) => item.key)).toEqual(["0", "1", "2", "3"]);
  });
  it("has a track for each, and one for the boxes", () => {
    expect(tracks(columnsFor(columns, 700), true)).toBe("36px minmax(0, 1fr) 100px");
    expect(tracks(columnsFor(columns, 360), false, true)).toBe("minmax(0, 1fr) 44px");
  });
});

describe("orders", () => {
  it("turns round at the second click", () => {
    expect(nextSort("", "name")).toBe("name");
    expect(nextSort("name", "name")).toBe("-name");
    expect(nextSort("-name", "name")).toBe("name");
  });
  it("is told to those who hear it", () => {
    expect(sortedAs("-name", "name")).toBe("descending");
    expect(sortedAs("name", "size")).toBe("none");
    expect(sortedAs("name", undefined)).toBeUndefined();
  });
});

describe("going from row to row", () => {
  it.each([
    ["ArrowDown", 0, 1], ["ArrowUp", 0, 0], ["End", 3, 99], ["Home", 50, 0], ["PageDown", 95, 99], ["a", 3, null],
  ] as const)("%s from %d", (key, active, expected) => expect(rowAfter(key, active, 100, 10)).toBe(expected));
  it("leads nowhere without rows", () => expect(rowAfter("End", 0, 0, 10)).toBeNull());
});

describe("choosing rows", () => {
  const keys = ["a", "b", "c", "d"];
  it("adds and takes away", () => {
    expect([...afterClick(new Set(), keys, 1, null)]).toEqual(["b"]);
    expect([...afterClick(new Set(["b"]), keys, 1, null)]).toEqual([]);
  });
  it("takes all between two clicks, in either direction", () => {
    expect([...afterClick(new Set(["a"]), keys, 2, 0)].sort()).toEqual(["a", "b", "c"]);
    expect([...afterClick(new Set(["d"]), keys, 1, 3)].sort()).toEqual(["b", "c", "d"]);
  });
});

describe("places of drawn rows", () => {
  it("stay with the rows that stay, and pass from those that went to those that come", () => {
    const first = placesOf([0, 1, 2, 3], new Map());
    const second = placesOf([2, 3, 4, 5], first);
    expect([...second.entries()].sort()).toEqual([[2, 2], [3, 3], [4, 0], [5, 1]]);
    expect(new Set(placesOf([100, 101, 102, 103], second).values())).toEqual(new Set([0, 1, 2, 3]));
  });
  it("are never shared, also where more rows come than went", () => {
    const more = placesOf([7, 1, 2, 3, 4, 5], placesOf([0, 1, 2], new Map()));
    expect(new Set(more.values()).size).toBe(6);
    expect([more.get(1), more.get(2)]).toEqual([1, 2]);
  });
});

describe("rows in sight", () => {
  it("are those of which something is seen, and four more on both sides", () => {
    expect(inSight(1000, 95, 10, 1000, 100)).toEqual(Array.from({ length: 18 }, (_, at) => 96 + at));
  });
  it("end with the table", () => {
    expect(inSight(-300, 400, 100, 3, 0)).toEqual([0, 1, 2]);
    expect(inSight(5000, 400, 100, 3, 0)).toEqual([0, 2]);
    expect(inSight(0, 400, 100, 0, 0)).toEqual([]);
  });
  it("have the one with the focus among them, wherever it is", () => {
    expect(inSight(1000, 10, 10, 1000, 2)[0]).toBe(2);
    expect(inSight(1000, 10, 10, 1000, 900).at(-1)).toBe(900);
  });
});

describe("rows that come into sight", () => {
  const upTo = (from: number, to: number) => Array.from({ length: to - from }, (_, at) => from + at);
  it("are all drawn the first time, and at once where they are few", () => {
    expect(drawnAfter([], upTo(0, 40), 0, 5)).toEqual(upTo(0, 40));
    expect(drawnAfter(upTo(0, 40), upTo(3, 43), 3, 5)).toEqual(upTo(3, 43));
  });
  it("are drawn by and by where they are many, in the places of those that went", () => {
    let drawn: readonly number[] = upTo(0, 12);
    const sizes: number[] = [];
    for (let frame = 0; frame < 3; frame += 1) {
      const next = drawnAfter(drawn, upTo(500, 512), 0, 5);
      sizes.push(next.filter((index) => !drawn.includes(index)).length);
      expect(next).toHaveLength(12);
      drawn = next;
    }
    expect(sizes).toEqual([5, 5, 2]);
    expect(drawn).toEqual(upTo(500, 512));
  });
  it("begin with the one that has the focus, then those in the middle", () => {
    expect(drawnAfter([7], [100, 101, 102, 103, 104], 104, 3).filter((index) => index > 7)).toEqual([101, 102, 104]);
  });
});

test("a click on a box changes that column alone, also where columns of another time are remembered", async () => {
  const columns = ["by", "took"].map((key) => ({ key, title: key }));
  const wrapper = mount(ColumnChooser, { props: { columns, modelValue: ["metric.of_another_list", "by"] } });
  const [by, took] = wrapper.findAll("input");
  await took?.trigger("change");
  await by?.trigger("change");
  expect(wrapper.emitted("update:modelValue")).toEqual([[["metric.of_another_list", "by", "took"]], [["metric.of_another_list", "took"]]]);
});
