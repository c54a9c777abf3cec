// What is said of failures beyond the server's own sentence.
const remedies: Readonly<Partial<Record<string, string>>> = {
  unreachable: "Look at your network; what you typed is still here. It is tried again by itself where that is safe.",
  not_authenticated: "Sign in again.",
  forbidden: "Ask somebody who owns the project for the right that it takes.",
  not_found: "It may have been moved or deleted, or you may not have been given access to it.",
  rate_limited: "Wait a moment, then try again.",
  name_taken: "Choose another name.",
  edit_conflict: "What you typed is still here: copy what you want to keep, cancel, and look at it as it is now.",
  file_exists: "Choose another name, or delete the file that is there.",
  quota_exceeded: "Ask an admin for more room, or delete what is not needed.",
  metadata_invalid: "Correct the fields that are named, then try again.",
  last_owner: "Give somebody else the right to delete first.",
  last_admin: "Make somebody else an admin first.",
  last_sign_in_method: "Link another provider first, or ask an admin for a link to a password.",
  store_unavailable: "The store of the bytes does not answer; try again in a minute.",
  database_unavailable: "The database does not answer; try again in a minute.",
  invalid_cursor: "Load the page anew.",
};

export const texts = {
  remedies,
  tellAdmin: "Try again; if it stays, tell an admin the request id.",
  unreachable: "The server does not answer",
  notAnswering: "Nothing came back from the server.",
  unexpected: "Something went wrong",
  notUnderstood: (status: number) => `The server answered with status ${status}, and with nothing that says why.`,
  requestId: "Request id",
  again: "Try again",
  showTechnical: "Details",
} as const;
