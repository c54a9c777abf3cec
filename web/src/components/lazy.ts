// Components whose code is loaded when they are first shown.
import { defineAsyncComponent, type AsyncComponentLoader, type Component } from "vue";
import { showToast } from "./toasts";
import { texts } from "@/texts/shell";

/** Pauses before a part of the app is requested again, such as after the Wi-Fi failed. */
const REPEAT_AFTER_MS = [250, 1000, 3000];

/** Returns a component that `load` imports, again where the network fails; a toast says where it cannot be loaded. */
export function lazyComponent<Loaded extends Component>(load: AsyncComponentLoader<Loaded>): Loaded {
  return defineAsyncComponent<Loaded>({
    loader: load,
    onError: (_error, repeat, fail, attempt) => {
      const pauseMs = REPEAT_AFTER_MS[attempt - 1];
      if (pauseMs !== undefined) {
        setTimeout(repeat, pauseMs);
        return;
      }
      showToast({ tone: "bad", text: texts.partGone });
      fail();
    },
  });
}
