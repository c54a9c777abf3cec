// The words of the page of tokens.
import type { components } from "@/api/schema";

type Scope = components["schemas"]["Scope"];
type TokenKind = components["schemas"]["TokenKind"];

interface Named {
  readonly label: string;
  readonly why: string;
}

const kinds: Readonly<Record<TokenKind, Named>> = {
  personal: { label: "Personal", why: "For a script or a notebook of yours: reaches what you reach, or less." },
  robot: { label: "Robot", why: "For a robot, a logger or a CI job: reaches only the projects and missions that you name." },
  runner: { label: "Runner", why: "For a runner of actions: claims runs and reports on them, nothing else. Admins make these." },
  run: { label: "Of one run", why: "Made for a run by the server; ends with it." },
};

const scopes: Readonly<Record<Scope, Named>> = {
  read: { label: "Read", why: "See, list, search, download, verify." },
  upload: { label: "Upload", why: "Make missions and send files, seeing no more than names." },
  write: { label: "Write", why: "Change and delete, with all that Read and Upload may." },
  run: { label: "Run", why: "Start and cancel runs." },
  admin: { label: "Everything", why: "All of these, grant rights, make tokens; for admins, with that power." },
};

export const texts = {
  title: "Tokens",
  lead: "A token stands for you where nobody is there to sign in. It can never do more than you can do now, and ends when you leave.",
  label: "Tokens",
  create: "New token",
  empty: "There are no tokens.",
  emptyText: "Give each robot and each script its own, with an end: one that is lost is then revoked alone.",
  emptyCommand: "klein token create anymal-3 --kind robot -p PROJECT",
  whose: "Whose",
  mine: "Mine",
  everybody: "Everybody’s",
  withEnded: "Also those that ended",
  columns: { name: "Name", person: "Whose", scopes: "May", limits: "Only in", used: "Last used", ends: "Ends", act: "Revoke" },
  everywhere: "Wherever its person may",
  nowhere: "Nothing that is left",
  unseen: (noun: string) => `A ${noun} you may not see`,
  begins: (prefix: string) => `${prefix}…`,
  never: "never",
  longest: (days: number) => (days === 0 ? "" : `${days} days at most.`),
  runnerLabels: "Only for actions that ask for one of these labels",
  runnerLabelsHint: "With commas between. The token is for the first runner that uses it, and for no other.",
  noEnd: "No end",
  revoked: "Revoked",
  expired: "Expired",
  revoke: "Revoke",
  revokeTitle: (name: string) => `Revoke ${name}?`,
  revokeWhy: "It ends with the next request, and with it all tokens that were made with it. This cannot be undone.",
  revokedToast: (name: string) => `${name} is revoked.`,
  record: "What was done with it",

  createTitle: "New token",
  name: "Name",
  nameHint: "What carries it: a robot, a machine, a script.",
  kind: "Kind",
  kinds,
  may: "What it may be used for",
  scopes,
  noScope: "Choose at least one.",
  places: "Projects and missions that it reaches",
  placesAll: "None chosen: it reaches whatever you reach.",
  placesNone: "A robot’s token reaches only what you choose here.",
  findPlace: "Find a project or mission by name",
  nothingFound: "No project or mission has such a name.",
  add: (name: string) => `Add ${name}`,
  remove: (name: string) => `Take ${name} out`,
  mission: (name: string, project: string) => `${project} / ${name}`,
  until: "How long it holds",
  make: "Make token",
  madeTitle: (name: string) => `${name} is made`,
  once: "This is shown once, and nobody can show it again. Copy it now to where it is needed; it does not belong in an image or a repository.",
  secret: "The token",
  login: "Or sign a machine in with it (reads it from the terminal, so that no history keeps it)",
  loginLine: (url: string) => `read -rs TOKEN && printf %s "$TOKEN" | klein login ${url} --token`,
} as const;
