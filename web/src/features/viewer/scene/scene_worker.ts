/** The worker that draws one scene: WebGL may take long, as where a browser draws it in software, and blocks nobody here. */
import { PointerTarget, type PointerCopy } from "./pointer_events";
import { SceneView, type SceneColours } from "./scene_view";

export type SceneMethod = "update" | "setColours" | "resize" | "showFrames" | "follow" | "reset" | "fit" | "zoom" | "turn";

export type ToScene =
  | { readonly type: "start"; readonly canvas: OffscreenCanvas; readonly colours: SceneColours }
  | { readonly type: "pointer"; readonly event: PointerCopy }
  | { readonly type: "end" }
  | SceneCall;

export type SceneCall = { readonly [M in SceneMethod]: { readonly type: "call"; readonly method: M; readonly args: Parameters<SceneView[M]> } }[SceneMethod];

export type FromScene = { readonly type: "updated"; readonly points: number } | { readonly type: "unsupported" };

// The DOM types lack the scope of a worker; these are the members used here.
const scope = self as unknown as {
  postMessage: (message: FromScene) => void;
  onmessage: ((event: MessageEvent<ToScene>) => void) | null;
  close: () => void;
};

const pointer = new PointerTarget();
let view: SceneView | null = null;

scope.onmessage = ({ data: message }) => {
  if (message.type === "start") start(message.canvas, message.colours);
  else if (message.type === "pointer") pointer.receive(message.event);
  else if (message.type === "call") call(message);
  else {
    view?.dispose();
    scope.close();
  }
};

function start(canvas: OffscreenCanvas, colours: SceneColours): void {
  try {
    view = new SceneView(canvas, pointer, colours, (points) => scope.postMessage({ type: "updated", points }));
  } catch {
    scope.postMessage({ type: "unsupported" });
  }
}

function call({ method, args }: SceneCall): void {
  if (view === null) return;
  if (method === "resize") [pointer.clientWidth, pointer.clientHeight] = args;
  (view[method] as (...values: unknown[]) => void)(...args);
}
