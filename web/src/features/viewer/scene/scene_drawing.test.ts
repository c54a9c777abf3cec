import { afterEach, expect, it, vi } from "vitest";
import { PointerTarget } from "./pointer_events";
import type { PlacedItem } from "./placement";
import { SceneDrawing } from "./scene_drawing";
import type { FromScene, SceneCall, ToScene } from "./scene_worker";
import { pointSetOf } from "@/recordings/geometry/points";
import { IDENTITY } from "@/recordings/geometry/poses";

const COLOURS = { background: "#fff", grid: "#ccc", plain: 0 };
const STYLE = { colourMap: "turbo", sizePx: 2 } as const;

class FakeWorker {
  static last: FakeWorker;
  readonly messages: ToScene[] = [];
  onmessage: ((event: { data: FromScene }) => void) | null = null;
  onerror: (() => void) | null = null;

  constructor() {
    FakeWorker.last = this;
  }

  postMessage(message: ToScene): void {
    this.messages.push(message);
  }

  /** Returns the ids of each update, and those that it brings. */
  get updates(): { ids: number[]; added: number[] }[] {
    const calls = this.messages.filter((message): message is Extract<SceneCall, { method: "update" }> => message.type === "call" && message.method === "update");
    return calls.map(({ args: [places, added] }) => ({ ids: places.map(({ id }) => id), added: [...added.keys()] }));
  }
}

function item(): PlacedItem {
  const points = pointSetOf({ x: Float64Array.of(1), y: Float64Array.of(2), z: Float64Array.of(3), channels: [], colours: null }, 1);
  return { item: { kind: "points", points, pose: IDENTITY }, pose: IDENTITY, colourBy: null };
}

function drawing() {
  vi.stubGlobal("Worker", FakeWorker);
  const [onDrawn, onFailed] = [vi.fn(), vi.fn()];
  const canvas = Object.assign(document.createElement("canvas"), { transferControlToOffscreen: () => ({}) });
  const scene = new SceneDrawing(canvas, COLOURS, { onDrawn, onFailed });
  return { scene, canvas, onDrawn, onFailed, worker: FakeWorker.last };
}

afterEach(() => vi.unstubAllGlobals());

it("sends what the worker does not have, once it has drawn what was sent before", () => {
  const { scene, worker, onDrawn } = drawing();
  const [first, second, third] = [item(), item(), item()];
  scene.update([first], STYLE);
  scene.update([second], STYLE);
  scene.update([first, third], STYLE);
  expect(worker.updates).toEqual([{ ids: [1], added: [1] }]);
  worker.onmessage?.({ data: { type: "updated", points: 1 } });
  expect(onDrawn).toHaveBeenCalledWith(1);
  expect(worker.updates.slice(1), "the second was out of date").toEqual([{ ids: [1, 2], added: [2] }]);
  worker.onmessage?.({ data: { type: "updated", points: 2 } });
  scene.reset();
  scene.update([first], STYLE);
  expect(worker.updates.at(-1), "another frame begins anew").toEqual({ ids: [1], added: [1] });
});

it("says why nothing is drawn", () => {
  const { worker, onFailed } = drawing();
  worker.onmessage?.({ data: { type: "unsupported" } });
  worker.onerror?.();
  expect(onFailed.mock.calls).toEqual([["unsupported"], ["ended"]]);
});

it("brings the wheel to the worker while the canvas has the focus", () => {
  const { canvas, worker } = drawing();
  document.body.append(Object.assign(canvas, { tabIndex: 0 }));
  const turn = () => new WheelEvent("wheel", { deltaY: 3, cancelable: true });
  canvas.dispatchEvent(turn());
  canvas.focus();
  canvas.dispatchEvent(turn());
  canvas.remove();
  const [message, ...others] = worker.messages.filter(({ type }) => type === "pointer");
  expect([message?.type, others]).toEqual(["pointer", []]);
  const target = new PointerTarget();
  const received = vi.fn();
  target.ownerDocument.addEventListener("wheel", (event) => {
    received((event as WheelEvent).deltaY);
  });
  if (message?.type === "pointer") target.receive(message.event);
  expect(received).toHaveBeenCalledWith(3);
});
