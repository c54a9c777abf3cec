// The words of these pages.
export const texts = {
  audit: { title: "Record", empty: "Nothing has been recorded." },
} as const;
