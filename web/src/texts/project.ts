// The words of these pages.
export const texts = {
  projects: { title: "Projects", empty: "There are no projects yet." },
  project: { title: "Project", empty: "Nothing is here yet." },
} as const;
