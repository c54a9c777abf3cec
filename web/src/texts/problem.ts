// Texts of errors: what to do about them.
const remedies: Readonly<Partial<Record<string, string>>> = {
  unreachable: "Check your network connection. Your input is still here. Safe requests are retried automatically.",
  not_authenticated: "Sign in again.",
  forbidden: "Ask a project owner for the required right.",
  not_found: "It was moved or deleted, or you do not have access to it.",
  rate_limited: "Wait a moment, then try again.",
  name_taken: "Choose another name.",
  edit_conflict: "Your input is still here. Copy what you need, cancel, and edit the current version.",
  file_exists: "Choose another name, or delete the existing file.",
  quota_exceeded: "Delete files, or ask an admin for a higher quota.",
  metadata_invalid: "Correct these fields, then try again.",
  last_owner: "First make someone else an owner.",
  last_admin: "First make someone else an admin.",
  last_sign_in_method: "First link another provider, or ask an admin for a link to set a password.",
  store_unavailable: "The object store does not respond. Try again in a minute.",
  database_unavailable: "The database does not respond. Try again in a minute.",
  invalid_cursor: "Reload the page.",
};

export const texts = {
  remedies,
  contactAdmin: "Try again. If the problem persists, send the request ID to an admin.",
  unreachable: "The server does not respond",
  notAnswering: "The server sent no response.",
  unexpected: "Something went wrong",
  notUnderstood: (status: number) => `The server returned status ${status} without an explanation.`,
  requestId: "Request ID",
  again: "Try again",
} as const;
