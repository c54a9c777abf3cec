// The time, for all that says how long ago something was: one clock for the page, running while anybody looks at it.
import { onScopeDispose, readonly, ref, type Ref } from "vue";

const TICK_MS = 20_000;
const now = ref(new Date());
let watchers = 0;
let timer: ReturnType<typeof setInterval> | undefined;

/** Returns the time, renewed every 20 s for as long as the component lives. */
export function useNow(): Readonly<Ref<Date>> {
  watchers += 1;
  if (timer === undefined) {
    now.value = new Date();
    timer = setInterval(() => (now.value = new Date()), TICK_MS);
  }
  onScopeDispose(() => {
    watchers -= 1;
    if (watchers > 0) return;
    clearInterval(timer);
    timer = undefined;
  });
  return readonly(now);
}
