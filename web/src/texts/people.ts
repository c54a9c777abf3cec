// Texts of the people pages and of the access overview.
import type { components } from "@/api/schema";
import { counted } from "@/components/format";

type Departure = components["schemas"]["Departure"];
type Erasure = components["schemas"]["Erasure"];
type Mention = components["schemas"]["Mention"];

function ended(departure: Departure): string {
  const parts = [counted(departure.sessions, "session"), counted(departure.tokens, "token"), counted(departure.links, "link")];
  const transferred = departure.projects.length === 0 ? "" : ` Projects now owned by the admins: ${departure.projects.join(", ")}.`;
  return `${departure.person.name} is deactivated. Revoked: ${parts.join(", ")}.${transferred}`;
}

function erased(erasure: Erasure): string {
  const ended = [counted(erasure.sessions ?? 0, "session"), counted(erasure.tokens ?? 0, "token"), counted(erasure.links ?? 0, "link")];
  const transferred = erasure.projects?.length ? ` Projects now owned by the admins: ${erasure.projects.join(", ")}.` : "";
  return `The person is erased and appears as “${erasure.person.name}”. Revoked: ${ended.join(", ")}.${transferred}`;
}

export const texts = {
  tabs: { label: "People and groups", people: "People", groups: "Groups", access: "Access" },
  people: {
    title: "People",
    leadAdmin: "Everyone with an account.",
    lead: "People who share a group or a project with you.",
    label: "People",
    find: "Name or email address",
    empty: "No matching people",
    emptyText: "People appear when they sign in or when an admin invites them.",
    columns: { name: "Name", emails: "Email addresses", since: "Member since" },
    admin: "Admin",
    left: "Deactivated",
    status: "Status",
    statuses: { "": "All", active: "Active", left: "Deactivated" } as const,
    shown: (count: number) => counted(count, "person", "people"),
  },
  invite: {
    button: "Invite a person",
    title: "Invite a person",
    text: "You get a link to send to them. By sending it, you confirm that the address is theirs.",
    email: "Email address",
    name: "Name (optional)",
    nameHint: "They can change it.",
    make: "Create link",
    doneTitle: "Invitation link",
    done: (email: string, until: string) => `Send this link to ${email}. It works once, until ${until}, and is not shown again.`,
    link: "Link",
  },
  person: {
    about: "About",
    emails: "Email addresses",
    noEmails: "not visible to you",
    since: "Member since",
    state: "State",
    active: "Active",
    left: "Deactivated",
    record: "Audit log",
    reset: "Reset password",
    resetTitle: (name: string) => `Create a password reset link for ${name}?`,
    resetWhy: "The person who opens the link sets a new password. This ends all their sessions and personal tokens.",
    resetMake: "Create link",
    resetDoneTitle: "Password reset link",
    resetDone: (name: string, until: string) => `Send this link only to ${name}. It works once, until ${until}, and is not shown again.`,
    makeAdmin: "Make admin",
    makeAdminTitle: (name: string) => `Make ${name} an admin?`,
    makeAdminWhy: "Admins have all rights on all projects. The audit log marks what they do with admin rights.",
    unmakeAdmin: "Revoke admin rights",
    unmakeAdminTitle: (name: string) => `Revoke the admin rights of ${name}?`,
    unmakeAdminWhy: "They keep only their own rights and the rights of their groups.",
    adminNow: (name: string) => `${name} is now an admin.`,
    adminNoMore: (name: string) => `${name} is no longer an admin.`,
    deactivate: "Deactivate",
    deactivateTitle: (name: string) => `Deactivate ${name}?`,
    deactivateWhy:
      "They can no longer sign in. Their sessions, tokens, and links are revoked permanently. Projects that only they own go to the admins. Their rights and memberships are kept for a later reactivation.",
    ended,
    reactivate: "Reactivate",
    reactivateTitle: (name: string) => `Reactivate ${name}?`,
    reactivateWhy: "They get back their rights and memberships. Revoked tokens and links stay revoked.",
    reactivated: (name: string) => `${name} can sign in again.`,
    erase: "Erase",
    eraseTitle: (name: string) => `Erase ${name}?`,
    eraseWhy:
      "This cannot be undone. Their addresses, sign-in methods, rights, and memberships are deleted. Sessions, tokens, and links are revoked. A pseudonym replaces their name everywhere, also in the audit log; what they did stays on record. Text that others wrote about them is not changed.",
    erased,
    gone: "Erased",
    mentionsTitle: "The person is still mentioned",
    mentionsWhy: "These texts contain their name or an address. They are not changed automatically.",
    mention: (mention: Mention) => `${mention.resource_type} ${mention.name}: ${mention.fields.join(", ")}`,
    export: "Export data",
    exportWhy: "Everything that is kept about this person, one JSON object per line",
  },
  reach: {
    title: "Access",
    lead: (count: number) => `Access to the ${counted(count, "project")} that you can see. For rights on single missions, see the mission.`,
    label: "Access",
    empty: "No access that you can see.",
    columns: { project: "Project", right: "Right", from: "Source", until: "Expires" },
  },
  access: {
    title: "Access",
    lead: "Current rights on a project or mission and their sources. If a person has several rights, the highest applies.",
    project: "Project",
    mission: "Mission",
    choose: "Choose a project",
    wholeProject: "Entire project",
    chooseText: "People who can write see everyone’s access. Others see their own.",
    manage: "Manage in the project",
  },
} as const;
