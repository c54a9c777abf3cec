// The words of these pages.
export const texts = {
  admin: { title: "Admin", empty: "Nothing is here yet." },
} as const;
