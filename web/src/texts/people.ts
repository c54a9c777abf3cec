// The words of these pages.
export const texts = {
  people: { title: "People", empty: "Nobody is here yet." },
  person: { title: "Person", empty: "Nothing is here yet." },
  groups: { title: "Groups", empty: "There are no groups yet." },
  group: { title: "Group", empty: "Nobody is in this group." },
  tokens: { title: "Tokens", empty: "There are no tokens." },
  sessions: { title: "Sessions", empty: "There are no sessions." },
} as const;
