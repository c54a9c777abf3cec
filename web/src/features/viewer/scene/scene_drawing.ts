// A scene that a worker draws: what it does not have yet is sent to it, and nothing before it has drawn the last update.
import type { PlacedItem } from "./placement";
import { forwardPointer } from "./pointer_events";
import type { Item, SceneColours, SceneStyle, SceneView } from "./scene_view";
import type { FromScene, SceneMethod, ToScene } from "./scene_worker";

interface Listeners {
  /** Gets how many points are drawn. */
  readonly onDrawn: (points: number) => void;
  /** Gets why nothing can be drawn: the browser has no WebGL 2 in workers, or the worker ended. */
  readonly onFailed: (reason: "unsupported" | "ended") => void;
}

interface Update {
  readonly items: readonly PlacedItem[];
  readonly style: SceneStyle;
}

const MAX_PIXEL_RATIO = 2;

export class SceneDrawing {
  private readonly worker = new Worker(new URL("./scene_worker.ts", import.meta.url), { type: "module", name: "scene" });
  private readonly ids = new WeakMap<Item, number>();
  private idCount = 0;
  /** The items of the last update that was sent. */
  private sent = new Set<number>();
  private isDrawing = false;
  private waiting: Update | null = null;

  constructor(canvas: HTMLCanvasElement, colours: SceneColours, { onDrawn, onFailed }: Listeners) {
    this.worker.onmessage = ({ data }: MessageEvent<FromScene>) => {
      if (data.type === "unsupported") onFailed("unsupported");
      else {
        onDrawn(data.points);
        this.isDrawing = false;
        this.sendWaiting();
      }
    };
    this.worker.onerror = () => onFailed("ended");
    const offscreen = canvas.transferControlToOffscreen();
    this.send({ type: "start", canvas: offscreen, colours }, [offscreen]);
    forwardPointer(canvas, (event) => this.send({ type: "pointer", event }));
  }

  /** Shows these items and no others, once what was sent before is drawn. */
  update(items: readonly PlacedItem[], style: SceneStyle): void {
    this.waiting = { items, style };
    this.sendWaiting();
  }

  resize(width: number, height: number): void {
    this.call("resize", width, height, Math.min(devicePixelRatio, MAX_PIXEL_RATIO));
  }

  /** Forgets where the camera and the items are, for another fixed frame. */
  reset(): void {
    this.sent.clear();
    this.call("reset");
  }

  /** Calls a method of the scene in the worker. */
  call<M extends SceneMethod>(method: M, ...args: Parameters<SceneView[M]>): void {
    this.send({ type: "call", method, args } as ToScene);
  }

  dispose(): void {
    this.send({ type: "end" });
  }

  private sendWaiting(): void {
    if (this.isDrawing || this.waiting === null) return;
    const { items, style } = this.waiting;
    [this.waiting, this.isDrawing] = [null, true];
    const placed = items.map(({ item, ...place }) => ({ item, place: { ...place, id: this.idOf(item) } }));
    const added = new Map(placed.filter(({ place: { id } }) => !this.sent.has(id)).map(({ item, place: { id } }) => [id, item]));
    this.sent = new Set(placed.map(({ place: { id } }) => id));
    this.call("update", placed.map(({ place }) => place), added, style);
  }

  private idOf(item: Item): number {
    const id = this.ids.get(item) ?? (this.idCount += 1);
    this.ids.set(item, id);
    return id;
  }

  private send(message: ToScene, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }
}
