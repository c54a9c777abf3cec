// The words of these pages.
export const texts = {
  trash: { title: "Trash", empty: "The trash is empty." },
} as const;
