// Texts of the page of public projects.
export const texts = {
  title: "Public projects",
  lead: "Anyone can view and download these projects without an account.",
  label: "Public projects",
  filter: "Filter by name or description",
  columns: { name: "Project", licence: "Licence", missions: "Missions", files: "Files", size: "Size" },
  search: "Search public projects",
  signIn: "Sign in",
  empty: "No public projects",
  emptyWhy: "Owners can make a project public in its settings. Sign in to see the projects that you have access to.",
  noneMatch: "No matching public projects",
} as const;
