// The words of these pages.
export const texts = {
  file: { title: "File", empty: "Nothing is here yet." },
} as const;
