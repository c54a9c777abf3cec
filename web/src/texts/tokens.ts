// Texts of the tokens page.
import type { components } from "@/api/schema";

type Scope = components["schemas"]["Scope"];
type TokenKind = components["schemas"]["TokenKind"];

interface Named {
  readonly label: string;
  readonly why: string;
}

const kinds: Readonly<Record<TokenKind, Named>> = {
  personal: { label: "Personal", why: "For your scripts and notebooks. Has your access or less." },
  robot: { label: "Robot", why: "For a robot, a logger, or a CI job. Limited to the projects and missions that you select." },
  runner: { label: "Runner", why: "For a runner of actions. Can only claim runs and report on them. Only admins can create these." },
  run: { label: "Run", why: "Created by the server for one run; expires with it." },
};

const scopes: Readonly<Record<Scope, Named>> = {
  read: { label: "Read", why: "View, search, download, and verify." },
  upload: { label: "Upload", why: "Create missions and upload files; sees only names." },
  write: { label: "Write", why: "Edit and delete, plus Read and Upload." },
  run: { label: "Run", why: "Start and cancel runs." },
  admin: { label: "Everything", why: "All scopes, plus granting rights and creating tokens. Includes admin rights for admins." },
};

export const texts = {
  title: "Tokens",
  lead: "Tokens let programs act on your behalf. A token never has more rights than you, and it expires when your account is deactivated.",
  label: "Tokens",
  create: "New token",
  empty: "No tokens",
  emptyText: "Use a separate token with an expiry date for each robot and script, so that you can revoke them individually.",
  emptyCommand: "klein token create anymal-3 --kind robot -p PROJECT",
  owner: "Owner",
  mine: "Mine",
  everybody: "All people",
  withEnded: "Include expired",
  columns: { name: "Name", person: "Owner", scopes: "Scopes", limits: "Limited to", used: "Last used", ends: "Expires", act: "Revoke" },
  everywhere: "Everything its owner can access",
  nowhere: "Nothing (all deleted)",
  unseen: (resourceType: string) => `A ${resourceType} without access`,
  begins: (prefix: string) => `${prefix}…`,
  never: "never",
  longest: (days: number) => (days === 0 ? "" : `At most ${days} days.`),
  runnerLabels: "Only for actions with one of these labels",
  runnerLabelsHint: "Separate labels with commas. Only the first runner that uses the token can use it.",
  noEnd: "No expiry",
  revoked: "Revoked",
  expired: "Expired",
  revoke: "Revoke",
  revokeTitle: (name: string) => `Revoke ${name}?`,
  revokeWhy: "The token and all tokens created with it stop working immediately. You cannot undo this.",
  revokedToast: (name: string) => `${name} revoked.`,
  record: "Audit log",

  createTitle: "New token",
  name: "Name",
  nameHint: "The robot, machine, or script that uses it.",
  kind: "Kind",
  kinds,
  may: "Scopes",
  scopes,
  noScope: "Select at least one.",
  placesAll: "If you select none, the token can access everything that you can access.",
  placesNone: "A robot token can access only what you select.",
  mission: (name: string, project: string) => `${project} / ${name}`,
  until: "Expiry",
  make: "Create token",
  madeTitle: (name: string) => `Token ${name} created`,
  once: "Copy the token now; it is not shown again. Do not store it in an image or a repository.",
  secret: "Token",
  login: "To sign in on a machine, run this command. It reads the token from the terminal, so the token does not appear in the shell history.",
  loginLine: (url: string) => `read -rs TOKEN && printf %s "$TOKEN" | klein login ${url} --token`,
} as const;
