// What can be said of a token before the server is asked.
import type { Scope, TokenCreate, TokenKind } from "./queries";
import type { Token } from "@/api/types";

const USUAL: Readonly<Record<TokenKind, readonly Scope[]>> = { personal: ["write"], robot: ["upload"], runner: ["run"], run: [] };
const OFFERED: Readonly<Record<TokenKind, readonly Scope[]>> = {
  personal: ["read", "upload", "write", "run", "admin"],
  robot: ["read", "upload", "write", "run"],
  runner: ["run"],
  run: [], // made by the server alone
};
const CONTAINED: Readonly<Partial<Record<Scope, readonly Scope[]>>> = {
  write: ["read", "upload"],
  admin: ["read", "upload", "write", "run"],
};

export interface Draft {
  readonly name: string;
  readonly kind: TokenKind;
  readonly scopes: readonly Scope[];
  readonly projectIds: readonly string[];
  readonly missionIds: readonly string[];
  readonly until: string | null;
  /** Of a runner's token: with commas between. */
  readonly labels: string;
}

/** Returns the scopes that a kind may have, and those that it has unless said. */
export function scopesOf(kind: TokenKind): { readonly offered: readonly Scope[]; readonly usual: readonly Scope[] } {
  return { offered: OFFERED[kind], usual: USUAL[kind] };
}

/** Says whether a scope is had anyway by another one that was chosen. */
export function isContained(scope: Scope, chosen: readonly Scope[]): boolean {
  return chosen.some((each) => CONTAINED[each]?.includes(scope) === true);
}

/** Says whether a draft has all that the server will ask for. */
export function isReady(draft: Draft): boolean {
  const isLimited = draft.projectIds.length + draft.missionIds.length > 0;
  return draft.name.trim() !== "" && draft.scopes.length > 0 && (draft.kind !== "robot" || isLimited);
}

/** Returns what is sent; a runner's token has one scope, and is limited to projects and labels at most. */
export function wanted(draft: Draft): TokenCreate {
  const isRunner = draft.kind === "runner";
  const labels = draft.labels.split(",").map((label) => label.trim()).filter((label) => label !== "");
  return {
    name: draft.name.trim(),
    kind: draft.kind,
    scopes: isRunner ? ["run"] : draft.scopes.filter((scope) => !isContained(scope, draft.scopes)),
    project_ids: [...draft.projectIds],
    mission_ids: [...draft.missionIds], // of a runner's token, the server refuses them
    expires_at: draft.until,
    no_end: draft.until === null,
    ...(isRunner && labels.length > 0 ? { runner_labels: labels } : {}),
  };
}

/** Returns how a token has ended; null while it holds. */
export function ending(token: Token, now: Date): "revoked" | "expired" | null {
  if (token.revoked_at !== null) return "revoked";
  return token.expires_at !== null && new Date(token.expires_at) <= now ? "expired" : null;
}
