// Queries and mutations of tokens, and their scopes.
import { keepPreviousData, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed, type ComputedRef } from "vue";
import { api, call } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { components } from "@/api/schema";
import type { Token } from "@/api/types";
import { globOf } from "@/components/format";
import { texts } from "@/texts/tokens";

export type TokenCreate = components["schemas"]["TokenCreate"];
export type Scope = components["schemas"]["Scope"];
export type TokenKind = components["schemas"]["TokenKind"];

export function useTokens(filters: () => { readonly everybody: boolean; readonly ended: boolean }) {
  return useList((query) => keys.tokens({ ...query }), filters, (query, signal) => call(api.GET("/api/v1/tokens", { params: { query }, signal })));
}

export function useTokenChanges() {
  const queries = useQueryClient();
  const old = () => void queries.invalidateQueries({ queryKey: ["tokens"] });
  return {
    create: async (body: TokenCreate) => {
      const made = await call(api.POST("/api/v1/tokens", { body }));
      old();
      return made;
    },
    revoke: async (token: Token) => {
      await call(api.DELETE("/api/v1/tokens/{token_id}", { params: { path: { token_id: token.id } } }));
      old();
    },
  };
}

export interface PlaceOffer {
  readonly resource_type: "project" | "mission";
  readonly id: string;
  readonly label: string;
}

const MAX_SUGGESTIONS = 8;

/** The first projects and missions whose names contain a text. */
export function usePlaces(typed: () => string, kinds: "missions" | "places"): ComputedRef<readonly PlaceOffer[] | undefined> {
  const offers = useQuery({
    queryKey: ["missions", kinds, typed],
    queryFn: async ({ signal }) => {
      const query = { limit: MAX_SUGGESTIONS, ...(typed() !== "" && { name: globOf(typed()) }) };
      const [projects, missions] = await Promise.all([
        kinds === "missions" ? { items: [] } : call(api.GET("/api/v1/projects", { params: { query }, signal })),
        call(api.GET("/api/v1/missions", { params: { query }, signal })),
      ]);
      return [
        ...projects.items.map(({ id, name }) => ({ resource_type: "project" as const, id, label: name })),
        ...missions.items.map(({ id, name, project }) => ({ resource_type: "mission" as const, id, label: texts.mission(name, project.name) })),
      ];
    },
    placeholderData: keepPreviousData,
  });
  return computed(() => offers.data.value);
}

const USUAL: Readonly<Record<TokenKind, readonly Scope[]>> = { personal: ["write"], robot: ["upload"], runner: ["run"], run: [] };
const ALLOWED: Readonly<Record<TokenKind, readonly Scope[]>> = {
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

/** Returns the allowed and the default scopes of a kind. */
export function scopesOf(kind: TokenKind): { readonly offered: readonly Scope[]; readonly usual: readonly Scope[] } {
  return { offered: ALLOWED[kind], usual: USUAL[kind] };
}

/** Returns whether a scope is included in another selected one. */
export function isContained(scope: Scope, chosen: readonly Scope[]): boolean {
  return chosen.some((item) => CONTAINED[item]?.includes(scope) === true);
}

/** Returns whether a draft is complete. */
export function isReady(draft: Draft): boolean {
  const isLimited = draft.projectIds.length + draft.missionIds.length > 0;
  return draft.name.trim() !== "" && draft.scopes.length > 0 && (draft.kind !== "robot" || isLimited);
}

/** Returns what is sent; a runner's token has one scope, and is limited to projects and labels at most. */
export function requestOf(draft: Draft): TokenCreate {
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
