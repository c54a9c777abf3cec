// The words of the page of public projects.
export const texts = {
  title: "Public projects",
  lead: "Anybody may look at these and download them, without an account.",
  label: "Public projects",
  filter: "Filter by name or description",
  columns: { name: "Project", licence: "Licence", missions: "Missions", files: "Files", size: "Size" },
  search: "Search in them",
  signIn: "Sign in",
  empty: "No project is public",
  emptyWhy: "Whoever owns a project may open it to everybody in its settings. What you may see beyond that is shown once you have signed in.",
  noneMatch: "No public project has that in its name or description",
} as const;
