// The color theme: light, dark, or the system's. Stored in the browser, for the server's own pages too.
import { ref } from "vue";

export type Theme = "system" | "light" | "dark";
export const THEMES: readonly Theme[] = ["system", "light", "dark"];
const STORAGE_KEY = "kleinkram.theme";

function storedTheme(): Theme {
  try {
    const value = localStorage.getItem(STORAGE_KEY);
    return value === "light" || value === "dark" ? value : "system";
  } catch {
    return "system";
  }
}

export const theme = ref<Theme>(storedTheme());

/** Chooses the colours, here and at the next visit. */
export function chooseTheme(choice: Theme): void {
  theme.value = choice;
  try {
    if (choice === "system") localStorage.removeItem(STORAGE_KEY);
    else localStorage.setItem(STORAGE_KEY, choice);
  } catch {
    return; // a browser that keeps nothing stays as the system is
  }
  dispatchEvent(new Event("kleinkram-theme-chosen")); // static/theme.js applies it
}
