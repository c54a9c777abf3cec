// Light or dark, before anything is painted: what was chosen here, else what the system prefers.
"use strict";

(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  function chosen() {
    try {
      return localStorage.getItem("kleinkram.theme");
    } catch {
      return null; // a browser that keeps nothing
    }
  }
  function apply() {
    const theme = chosen() || (dark.matches ? "dark" : "light");
    if (document.documentElement.dataset.theme === theme) return;
    document.documentElement.dataset.theme = theme;
    dispatchEvent(new CustomEvent("kleinkram-theme"));
  }
  dark.addEventListener("change", apply);
  addEventListener("storage", apply);
  addEventListener("kleinkram-theme-chosen", apply);
  apply();
})();
