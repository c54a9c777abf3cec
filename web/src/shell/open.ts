// Which of the shell's windows are open.
import { ref } from "vue";

export const isShowingKeys = ref(false);
export const isShowingPalette = ref(false);
