// The words of the page of sessions.
export const texts = {
  title: "Sessions",
  lead: "Browsers that are signed in as you. Programs are signed in by tokens.",
  label: "Sessions",
  tokens: "Your tokens",
  columns: { browser: "Browser", method: "Signed in with", used: "Last used", ends: "Ends", act: "End" },
  here: "This browser",
  unknownBrowser: "Unknown browser",
  on: (browser: string, system: string) => `${browser} on ${system}`,
  methods: { password: "Password", link: "One-time link", bootstrap: "Bootstrap code" } as Readonly<Record<string, string>>,
  since: "since",
  end: "End",
  ended: (browser: string) => `${browser} is signed out.`,
  endAll: "Sign out everywhere",
  endAllTitle: "Sign out everywhere?",
  endAllWhy: "All browsers, this one too, are signed out at once. Tokens stay: revoke those of a machine that was lost as well.",
} as const;
