// The words of these pages.
export const texts = {
  public: { title: "Public projects", empty: "No project is public." },
} as const;
