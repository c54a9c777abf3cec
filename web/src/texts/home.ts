// The words of these pages.
export const texts = {
  home: { title: "Home", empty: "Nothing has been uploaded yet." },
} as const;
