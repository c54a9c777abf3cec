// Texts of the access to projects and missions.
import type { components } from "@/api/schema";

type AccessThrough = components["schemas"]["AccessThrough"];

const through: Readonly<Record<AccessThrough, string>> = {
  "project grant": "Right on the project",
  "mission grant": "Right on the mission",
  public: "The project is public",
  admin: "Admins have access to everything",
};

export const texts = {
  grants: { project: "Granted on this project", mission: "Granted on this mission" },
  grantsWhy: {
    project: "Rights on a project apply to all its missions.",
    mission: "These rights add to the rights on the project.",
  },
  noGrants: "No rights granted here.",
  right: "Right",
  until: "Until",
  noEnd: "No expiry",
  expired: "expired",
  rightOf: (name: string) => `Right of ${name}`,
  endOf: (name: string) => `Expiry of the right of ${name}`,
  revokeOf: (name: string) => `Revoke the right of ${name}`,
  revokeTitle: "Revoke this right?",
  revokeWhy: (name: string) => `${name} loses access immediately.`,
  revoke: "Revoke",
  revoked: (name: string) => `Right of ${name} revoked.`,
  changed: "Right changed.",
  kinds: { person: "Person", group: "Group", email: "Email address" },

  add: "Grant a right",
  who: "Person, group, or email address",
  whoHint: "An email address works even if no account has it yet.",
  chooseOne: "Choose someone from the list, or enter a complete email address.",
  candidates: "Matches",
  untilHint: "Leave empty for no expiry.",
  grant: "Grant",
  granted: (name: string) => `Right granted to ${name}.`,

  access: "Effective access",
  accessWhy: "If a person has several rights, the highest applies.",
  accessOwn: "You see your own access. People who can change rights see everyone’s.",
  columns: { who: "Who", right: "Right", from: "Source", until: "Expires" },
  through,
  everybody: "Everyone, without an account",
  admins: "All admins",
  members: (group: string) => `Members of ${group}`,
  address: (email: string) => `Owner of ${email}`,
  byGroup: (group: string) => `as a member of ${group}`,
  nobody: "No access that you can see.",
} as const;
