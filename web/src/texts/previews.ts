// Texts of previews: of a mission, the large view, and pictures in lists.
import { counted } from "@/components/format";

export const texts = {
  title: "Previews",
  of: (action: string, version: number | null) => (version === null ? action : `${action} v${version}`),
  outdated: "Outdated",
  outdatedWhy: "What the action reads of the mission has changed since. Run the action again to update this.",
  all: (count: number) => `Show all ${counted(count, "preview")}`,
  fewer: "Show fewer",
  truncated: (count: number) => `These are the first ${count} previews. The pages of the runs show all.`,
  none: "No previews yet.",
  how: "The action kleinkram/preview makes pictures of cameras, lidar and tracks.",
  launch: "Run an action",
  library: "Actions and library",
  previous: "Previous",
  next: "Next",
  place: (at: number, count: number) => `${at} of ${count}`,
  keys: "The arrow keys show the previous and the next picture.",
  run: "Open the run",
  recorded: "Picture of a camera",
} as const;
