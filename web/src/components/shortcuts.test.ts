import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { effectScope, type EffectScope } from "vue";
import { nameOf, shortcuts, setShortcutsOn, useShortcuts } from "./shortcuts";

let scope: EffectScope;
const run = { search: vi.fn(), palette: vi.fn(), projects: vi.fn(), back: vi.fn() };

function press(key: string, more: KeyboardEventInit = {}, target: EventTarget = document.body): void {
  target.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true, ...more }));
}

beforeEach(() => {
  scope = effectScope();
  scope.run(() =>
    useShortcuts([
      { keys: "/", does: "search", run: run.search },
      { keys: "mod+k", does: "palette", run: run.palette },
      { keys: "ArrowLeft", does: "back", run: run.back },
      { keys: "g p", does: "projects", run: run.projects },
    ]),
  );
});
afterEach(() => {
  scope.stop();
  setShortcutsOn(true);
  for (const item of Object.values(run)) item.mockClear();
  document.body.replaceChildren();
});

describe("keys", () => {
  it("do what they say", () => {
    press("/");
    press("k", { ctrlKey: true });
    press("K", { metaKey: true });
    expect(run.search).toHaveBeenCalledTimes(1);
    expect(run.palette).toHaveBeenCalledTimes(2);
  });
  it("may be two after each other", () => {
    press("p");
    expect(run.projects).not.toHaveBeenCalled();
    press("g");
    press("p");
    expect(run.projects).toHaveBeenCalledTimes(1);
  });
  it("leave alone whoever types, except with Ctrl", () => {
    const box = document.createElement("input");
    document.body.append(box);
    press("/", {}, box);
    press("k", { ctrlKey: true }, box);
    expect(run.search).not.toHaveBeenCalled();
    expect(run.palette).toHaveBeenCalledTimes(1);
  });
  it("work while a slider has the focus, except those that move it", () => {
    const slider = document.createElement("input");
    slider.type = "range";
    document.body.append(slider);
    press("/", {}, slider);
    press("ArrowLeft", {}, slider);
    expect(run.search).toHaveBeenCalledTimes(1);
    expect(run.back).not.toHaveBeenCalled();
    press("ArrowLeft");
    expect(run.back).toHaveBeenCalledTimes(1);
  });
  it("can be turned off, except with Ctrl", () => {
    setShortcutsOn(false);
    press("/");
    press("k", { ctrlKey: true });
    expect(run.search).not.toHaveBeenCalled();
    expect(run.palette).toHaveBeenCalledTimes(1);
    expect(localStorage.getItem("kleinkram.shortcuts")).toBe("off");
  });
  it("end with what they belong to", () => {
    scope.stop();
    press("/");
    expect(run.search).not.toHaveBeenCalled();
    expect(shortcuts).toHaveLength(0);
  });
});

it("names what was pressed", () => {
  expect(nameOf({ key: "K", ctrlKey: true, metaKey: false, altKey: false }, "")).toBe("mod+k");
  expect(nameOf({ key: "p", ctrlKey: false, metaKey: false, altKey: false }, "g")).toBe("g p");
  expect(nameOf({ key: "p", ctrlKey: false, metaKey: false, altKey: true }, "")).toBe("");
});
