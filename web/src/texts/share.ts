// Texts of share links.
import { counted } from "@/components/format";

export const texts = {
  title: "Share with a link",
  why: "Anyone with the link can view and download without an account until it expires. The audit log records their actions under the name of the link.",
  whole: "The entire mission, including future files",
  wholeShows: "It also shows the verdict, the checks, and why failing checks were accepted; no notes, and no names of who accepted them.",
  some: (count: number) => counted(count, "selected file"),
  tooMany: (most: number) => `A link can share at most ${most} files, or an entire mission.`,
  what: "Shared content",
  name: "Purpose or recipient",
  nameHint: "Helps you identify the link later.",
  days: "Expires after",
  inDays: (days: number) => (days === 365 ? "a year" : counted(days, "day")),
  create: "Create link",
  made: "Link",
  madeWhy: (until: string) => `Copy the link now; it is not shown again. It works until ${until}.`,
  links: "Links",
  linksWhy: "Links to this mission that you can revoke.",
  noLinks: "No links.",
  shows: (count: number | null) => (count === null ? "entire mission" : counted(count, "file")),
  until: (when: string) => `until ${when}`,
  used: (count: number, bytes: string) => (count === 0 ? "no downloads" : `${counted(count, "download")}, ${bytes}`),
  madeBy: (who: string) => `by ${who}`,
  revoked: "revoked",
  expired: "expired",
  revoke: "Revoke",
  revokeTitle: "Revoke this link?",
  revokeWhy: "The link stops working immediately. Downloads in progress can continue for a while.",
  revokedNow: (name: string) => `Link “${name}” revoked.`,
  another: "Create another link",
} as const;

export const sharedTexts = {
  files: "Files of this link",
  ended: "This link has ended, or its address is incomplete",
  endedWhy: "Ask the person who sent it for another one.",
} as const;

export const publicTexts = {
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
