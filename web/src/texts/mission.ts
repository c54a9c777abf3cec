// The words of these pages.
export const texts = {
  mission: { title: "Mission", empty: "Nothing is here yet." },
} as const;
