// The words of the pages for admins.
import { counted } from "@/components/format";

const states: Readonly<Record<string, string>> = {
  stored: "Stored", proven: "Proven", lost: "Lost", corrupt: "Corrupt", doomed: "To be swept", todo: "Waits", doing: "Under way", failed: "Given up",
};

export const texts = {
  title: "Admin",
  tabs: { label: "Admin", storage: "Storage", jobs: "Jobs", health: "Health", settings: "Settings" },
  notForYou: "This page is for admins",
  notForYouText: "It shows the whole server: its store, its jobs, its health, its settings. An admin can make you one.",
  whoIsAdmin: "Who is here",

  storage: {
    low: "The store is nearly full: uploads will soon be refused. Delete what is not needed, or give it a larger disk.",
    disk: "The store’s disk",
    used: (used: string, total: string) => `${used} of ${total} are used`,
    free: (free: string) => `${free} are free`,
    unknown: "How full the store is, it does not say.",
    holds: (size: string) => `${size} are kept.`,
    kept: "What it keeps",
    columns: { what: "What", count: "How many", size: "Size" },
    blobs: (state: string) => `Contents: ${states[state]?.toLowerCase() ?? state}`,
    trash: "Only in the trash",
    trashWhy: "What no file outside the trash is made of",
    uploads: "On its way",
    uploadsWhy: "Uploads that have begun and are not complete",
    doomed: "Gone at the next sweep",
    doomedWhy: "What nothing is made of any more",
    openTrash: "Open the trash",
  },
  jobs: {
    queue: "The queue",
    columns: { kind: "Job", state: "State", count: "How many", oldest: "Oldest", ref: "For", attempts: "Tries", failed: "Given up", act: "Try again" },
    states,
    idle: "Nothing waits, and nothing has failed.",
    failed: "Given up",
    failedWhy: "These failed as often as they are tried. The worker’s log says more, under their number; each is forgotten after a week.",
    none: "No job was given up.",
    retry: "Try again",
    retried: (id: number) => `Job ${id} is in the queue again.`,
    number: (id: number) => `#${id}`,
  },
  health: {
    ready: "Everything that it needs answers.",
    facts: {
      version: "Kleinkram", schema: "Tables", database: "PostgreSQL", databaseSize: "Database holds", workers: "Workers", clock: "Clocks apart",
      checksum: "The store proves by", once: "The store refuses to overwrite", pages: "Browsers may send to the store", now: "Server’s time",
    },
    workers: (count: number) => counted(count, "worker"),
    noWorkers: "None is heard of: nothing is read, proven or swept. See that one runs.",
    heard: (count: number) => (count === 1 ? "last heard of" : "the quietest last heard of"),
    yes: "Yes",
    no: "No",
    seconds: (value: number) => `${value.toFixed(2)} s`,
  },
  settings: {
    lead: "What the process that answered is set to, by its environment; the rest are defaults.",
    find: "Name of a setting",
    onlySet: "Only what is set",
    label: "Settings in force",
    columns: { name: "Setting", value: "Value", from: "From" },
    set: "Environment",
    standard: "Default",
    secret: "set, and not shown",
    noSecret: "not set",
    none: "No setting has such a name.",
    empty: "none",
  },
} as const;
