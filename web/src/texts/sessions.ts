// Texts of the sessions page.
export const texts = {
  title: "Sessions",
  lead: "Browsers that are signed in to your account. Programs use tokens instead.",
  label: "Sessions",
  tokens: "Your tokens",
  columns: { browser: "Browser", method: "Sign-in method", used: "Last used", ends: "Expires", act: "Sign out" },
  here: "This browser",
  unknownBrowser: "Unknown browser",
  on: (browser: string, system: string) => `${browser} on ${system}`,
  methods: { password: "Password", link: "One-time link", bootstrap: "Setup code" } as Readonly<Record<string, string>>,
  since: "since",
  end: "Sign out",
  ended: (browser: string) => `${browser} signed out.`,
  endAll: "Sign out everywhere",
  endAllTitle: "Sign out everywhere?",
  endAllWhy: "This immediately signs out all browsers, including this one. Tokens stay valid; revoke the tokens of lost machines separately.",
} as const;
