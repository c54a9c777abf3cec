// Toast messages: what was done, and how to undo it.
import { reactive } from "vue";

export interface Toast {
  readonly tone: "good" | "bad" | "plain";
  readonly text: string;
  /** What a button beside the text does, such as undoing. */
  readonly act?: { readonly label: string; readonly run: () => void };
}

interface Shown extends Toast {
  readonly id: number;
}

const SHOWN_MS = 6000;
const WITH_BUTTON_MS = 12_000;
const MAX = 4;
let last = 0;

export const toasts = reactive<Shown[]>([]);

/** Takes a message away. */
export function dismiss(id: number): void {
  const at = toasts.findIndex((toast) => toast.id === id);
  if (at >= 0) toasts.splice(at, 1);
}

/** Shows a message for some seconds; a bad one stays until it is dismissed. */
export function showToast(toast: Toast): void {
  last += 1;
  const id = last;
  toasts.push({ ...toast, id });
  if (toasts.length > MAX) toasts.shift();
  if (toast.tone !== "bad") setTimeout(() => dismiss(id), toast.act ? WITH_BUTTON_MS : SHOWN_MS);
}
