// What the page of tokens asks the server, and what it has it do.
import { useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed, type ComputedRef } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import { usePages } from "@/api/pages";
import type { components } from "@/api/schema";
import type { Token } from "@/api/types";
import { texts } from "@/texts/tokens";

export type TokenCreate = components["schemas"]["TokenCreate"];
export type Scope = components["schemas"]["Scope"];
export type TokenKind = components["schemas"]["TokenKind"];

export interface TokenQuery {
  readonly everybody: boolean;
  readonly ended: boolean;
}

export function useTokens(query: () => TokenQuery) {
  return usePages(
    () => keys.tokens({ ...query() }),
    (cursor, signal) => {
      const asked = { ...query(), ...(cursor !== undefined && { cursor }) };
      return call(api.GET("/api/v1/tokens", { params: { query: asked }, signal }));
    },
  );
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
  readonly noun: "project" | "mission";
  readonly id: string;
  readonly label: string;
}

const OFFERED = 8;

/** Projects and missions whose names hold what was typed. */
export function usePlaces(typed: () => string): ComputedRef<readonly PlaceOffer[] | undefined> {
  const found = useQuery({
    queryKey: ["missions", "places", typed],
    queryFn: async ({ signal }) => {
      const query = { limit: OFFERED, ...(typed() !== "" && { name: `*${typed()}*` }) };
      const [projects, missions] = await Promise.all([
        call(api.GET("/api/v1/projects", { params: { query }, signal })),
        call(api.GET("/api/v1/missions", { params: { query }, signal })),
      ]);
      return [
        ...projects.items.map(({ id, name }) => ({ noun: "project" as const, id, label: name })),
        ...missions.items.map(({ id, name, project }) => ({ noun: "mission" as const, id, label: texts.mission(name, project.name) })),
      ];
    },
  });
  return computed(() => found.data.value);
}
