// What somebody types into a box, and what it asks for after a pause.
import { onScopeDispose, ref, watch, type Ref } from "vue";

export interface Typed {
  readonly typed: Ref<string>;
  /** Asks for what is typed now. */
  readonly apply: () => void;
  readonly onInput: () => void;
}

/** Returns what is typed; `text` becomes it after a pause. A text that comes from elsewhere takes its place. */
export function useTyped(text: Ref<string>, pauseMs: number): Typed {
  const typed = ref(text.value);
  /** What was asked for last: once that is so, more may have been typed. */
  let applied = text.value;
  let timer: ReturnType<typeof setTimeout> | undefined;

  watch(text, (value) => {
    if (value === applied) return;
    clearTimeout(timer);
    applied = typed.value = value;
  });

  function apply(): void {
    clearTimeout(timer);
    text.value = applied = typed.value.trim();
  }

  function onInput(): void {
    clearTimeout(timer);
    timer = setTimeout(apply, pauseMs);
  }

  onScopeDispose(() => clearTimeout(timer));
  return { typed, apply, onInput };
}
