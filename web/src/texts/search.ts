// The words of these pages.
export const texts = {
  search: { title: "Search", empty: "Type what you look for." },
} as const;
