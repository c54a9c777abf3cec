// Sends the pointer events of a canvas to the worker that draws it, where OrbitControls gets them.

type Fields = Pick<PointerEvent, "pointerId" | "pointerType"> & Pick<WheelEvent, "deltaY" | "deltaMode">
  & Pick<MouseEvent, "button" | "clientX" | "clientY" | "pageX" | "pageY" | "ctrlKey" | "metaKey" | "shiftKey">;

/** What OrbitControls reads of an event. A wheel has no pointer, a pointer no wheel. */
export interface PointerCopy {
  readonly type: string;
  readonly fields: Partial<Fields>;
}

const FIELDS = [
  "pointerId", "pointerType", "deltaY", "deltaMode", "button", "clientX", "clientY", "pageX", "pageY", "ctrlKey", "metaKey", "shiftKey",
] as const satisfies readonly (keyof Fields)[];

function copyOf(event: Event): PointerCopy {
  const values = event as unknown as Partial<Fields>;
  return { type: event.type, fields: Object.fromEntries(FIELDS.filter((name) => values[name] !== undefined).map((name) => [name, values[name]])) };
}

/** Calls `send` with the events of a canvas: the wheel only while it has the focus, since it scrolls the page otherwise. */
export function forwardPointer(canvas: HTMLCanvasElement, send: (event: PointerCopy) => void): void {
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    send(copyOf(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) send(copyOf(event));
  });
  for (const type of ["pointerup", "pointercancel"] as const) canvas.addEventListener(type, (event) => send(copyOf(event)));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    send(copyOf(event));
  }, { passive: false });
}

/** Stands for the canvas, and its document, in the worker: the members that OrbitControls uses. */
export class PointerTarget extends EventTarget {
  readonly ownerDocument = this;
  readonly style: Record<string, string> = {};
  clientWidth = 1;
  clientHeight = 1;

  /** Has the listeners handle an event of the canvas. */
  receive({ type, fields }: PointerCopy): void {
    this.dispatchEvent(Object.assign(new Event(type), fields));
  }

  getBoundingClientRect(): { left: number; top: number; width: number; height: number } {
    return { left: 0, top: 0, width: this.clientWidth, height: this.clientHeight };
  }

  /** The canvas captures the pointer. */
  setPointerCapture(): void {}

  releasePointerCapture(): void {}
}
