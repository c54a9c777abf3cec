// Light, dark, or as the system prefers. What is chosen is kept in the browser, for the server's own pages too.
import { ref } from "vue";

export type Theme = "system" | "light" | "dark";
export const THEMES: readonly Theme[] = ["system", "light", "dark"];
const KEPT_AS = "kleinkram.theme";

function kept(): Theme {
  try {
    const value = localStorage.getItem(KEPT_AS);
    return value === "light" || value === "dark" ? value : "system";
  } catch {
    return "system";
  }
}

export const theme = ref<Theme>(kept());

/** Chooses the colours, here and at the next visit. */
export function chooseTheme(wanted: Theme): void {
  theme.value = wanted;
  try {
    if (wanted === "system") localStorage.removeItem(KEPT_AS);
    else localStorage.setItem(KEPT_AS, wanted);
  } catch {
    return; // a browser that keeps nothing stays as the system is
  }
  dispatchEvent(new Event("kleinkram-theme-chosen")); // static/theme.js applies it
}
