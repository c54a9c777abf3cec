// The words of the pages of people, and of who gets what from where.
import type { components } from "@/api/schema";
import { counted } from "@/components/format";

type AccessThrough = components["schemas"]["AccessThrough"];
type Departure = components["schemas"]["Departure"];

const through: Readonly<Record<AccessThrough, string>> = {
  "project grant": "Right on the project",
  "mission grant": "Right on the mission",
  public: "The project is public",
  admin: "Admins reach everything",
};

function ended(departure: Departure): string {
  const parts = [counted(departure.sessions, "session"), counted(departure.tokens, "token"), counted(departure.links, "link")];
  const given = departure.projects.length === 0 ? "" : ` To the admins went: ${departure.projects.join(", ")}.`;
  return `${departure.person.name} is deactivated; ended: ${parts.join(", ")}.${given}`;
}

export const texts = {
  tabs: { label: "People and groups", people: "People", groups: "Groups", access: "Who gets what" },
  people: {
    title: "People",
    leadAdmin: "Everybody who has an account here.",
    lead: "The people who share a group or a project with you.",
    label: "People",
    find: "Name or address",
    empty: "Nobody is found.",
    emptyText: "People appear here once they sign in, or once an admin invites them.",
    columns: { name: "Name", emails: "Addresses", since: "Since" },
    admin: "Admin",
    left: "Deactivated",
    whom: "Whom",
    whoms: { "": "Everybody", active: "Active", left: "Deactivated" } as const,
    shown: (count: number) => counted(count, "person", "people"),
  },
  invite: {
    button: "Invite somebody",
    title: "Invite somebody",
    text: "They get an account by a link that you send them. That the address is theirs is your word.",
    email: "E-mail address",
    name: "Name, if you know it",
    nameHint: "They can write it differently.",
    make: "Make the link",
    doneTitle: "The invitation",
    done: (email: string, until: string) => `Send this link to ${email}. It is good once, until ${until}, and shown only here.`,
    link: "The link",
  },
  person: {
    about: "About",
    emails: "Addresses",
    noEmails: "none that you may see",
    since: "Since",
    state: "State",
    active: "Active",
    left: "Deactivated",
    record: "What they did",
    reset: "Link to a new password",
    resetTitle: (name: string) => `A link to a new password for ${name}?`,
    resetWhy: "Whoever opens it chooses a new password; then all their sessions and personal tokens end.",
    resetMake: "Make the link",
    resetDoneTitle: "Link to a new password",
    resetDone: (name: string, until: string) => `Give this link to ${name}, and to nobody else. It is good once, until ${until}, and shown only here.`,
    makeAdmin: "Make admin",
    makeAdminTitle: (name: string) => `Make ${name} an admin?`,
    makeAdminWhy: "They then see and do everything here, in every project. What they do by that power is marked in the record.",
    unmakeAdmin: "Take admin away",
    unmakeAdminTitle: (name: string) => `Take the power of an admin from ${name}?`,
    unmakeAdminWhy: "They keep what they were granted themselves and by their groups, and nothing beyond.",
    adminNow: (name: string) => `${name} is an admin now.`,
    adminNoMore: (name: string) => `${name} is no admin any more.`,
    deactivate: "Deactivate",
    deactivateTitle: (name: string) => `Deactivate ${name}?`,
    deactivateWhy:
      "With their next request they are out: their sessions, tokens and links end for good, and they cannot sign in. Projects that only they own go to the admins. Their name stays beside what they did; rights and memberships rest until they come back.",
    ended,
    reactivate: "Let back in",
    reactivateTitle: (name: string) => `Let ${name} sign in again?`,
    reactivateWhy: "They have the rights and memberships that they had. Tokens and links stay ended.",
    reactivated: (name: string) => `${name} may sign in again.`,
  },
  reach: {
    title: "What they reach",
    lead: (count: number) => `Looked up in the ${counted(count, "project")} that you see. Rights on single missions are told by the mission.`,
    label: "What they reach",
    empty: "Nothing that you may know of.",
    columns: { project: "Project", right: "May", from: "From where", until: "Until" },
  },
  access: {
    title: "Who gets what",
    lead: "Who may do what on a project or a mission now, and what gives it to them. Of several ways, the highest counts.",
    label: "Who gets what from where",
    project: "Project",
    mission: "Mission",
    choose: "Choose a project",
    wholeProject: "The project itself",
    chooseText: "Owners, and whoever may write, see everybody; others see what is their own.",
    empty: "Nobody gets anything here that you may know of.",
    columns: { who: "Who", right: "May", from: "From where", until: "Until" },
    everybody: "Everybody, without an account",
    admins: "All admins",
    members: (group: string) => `Whoever is in ${group}`,
    address: (email: string) => `Whoever has ${email}`,
    byGroup: (group: string) => `as a member of ${group}`,
    oneself: "given to them",
    through,
    noEnd: "No end",
    manage: "Change in the project",
  },
} as const;
