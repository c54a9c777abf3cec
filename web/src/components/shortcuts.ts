// Global keyboard shortcuts. Users can turn them off, except those with Ctrl.
import { onScopeDispose, ref, shallowReactive } from "vue";

export interface Shortcut {
  /** A key as the browser names it (`/`, `?`, `n`), two after each other (`g p`), or one with Ctrl or Cmd (`mod+k`). */
  readonly keys: string;
  readonly does: string;
  readonly run: () => void;
}

const STORAGE_KEY = "kleinkram.shortcuts";
const BETWEEN_MS = 1200;

/** All that are in force, the latest last. */
export const shortcuts = shallowReactive<Shortcut[]>([]);
export const areShortcutsOn = ref(read());

let first = "";
let firstAt = 0;

function read(): boolean {
  try {
    return localStorage.getItem(STORAGE_KEY) !== "off";
  } catch {
    return true; // a browser that keeps nothing
  }
}

/** Turns the keys without Ctrl on or off, here and at the next visit. */
export function setShortcutsOn(isOn: boolean): void {
  areShortcutsOn.value = isOn;
  try {
    localStorage.setItem(STORAGE_KEY, isOn ? "on" : "off");
  } catch {
    return; // they are off until the page is left
  }
}

function isTyping(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target.isContentEditable || target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement) return true;
  return target instanceof HTMLInputElement && !["checkbox", "radio", "button", "submit", "range"].includes(target.type);
}

const SLIDER_KEYS = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"];

/** Whether what has the focus uses the key: the space bar presses it, arrows move a slider. */
function isUsedBy(target: EventTarget | null, name: string): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (name === " ") return target.matches("a, button, summary, input, [role=button]");
  return SLIDER_KEYS.includes(name) && target.matches("input[type=range]");
}

/** Returns the name of a key press: `n`, `mod+k`, or `g p` if `before` is the first key of a pair. */
export function nameOf(event: Pick<KeyboardEvent, "key" | "ctrlKey" | "metaKey" | "altKey">, before: string): string {
  if (event.altKey) return "";
  if (event.ctrlKey || event.metaKey) return `mod+${event.key.toLowerCase()}`;
  return before === "" ? event.key : `${before} ${event.key}`;
}

function onKey(event: KeyboardEvent): void {
  if (event.defaultPrevented || event.isComposing) return;
  const before = event.timeStamp - firstAt < BETWEEN_MS ? first : "";
  first = "";
  const name = nameOf(event, before);
  const isWithCtrl = name.startsWith("mod+");
  const isDialogOpen = document.querySelector("dialog[open]") !== null;
  if (!isWithCtrl && (!areShortcutsOn.value || isTyping(event.target) || isDialogOpen)) return;
  if (isUsedBy(event.target, name)) return;
  const match = shortcuts.findLast((shortcut) => shortcut.keys === name);
  if (match !== undefined) {
    event.preventDefault();
    match.run();
  } else if (shortcuts.some((shortcut) => shortcut.keys.startsWith(`${name} `))) {
    first = name;
    firstAt = event.timeStamp;
  }
}

/** Puts shortcuts into force for as long as the component lives. */
export function useShortcuts(added: readonly Shortcut[]): void {
  if (shortcuts.length === 0) window.addEventListener("keydown", onKey);
  shortcuts.push(...added);
  onScopeDispose(() => {
    for (const item of added) shortcuts.splice(shortcuts.indexOf(item), 1);
    if (shortcuts.length === 0) window.removeEventListener("keydown", onKey);
  });
}
