// Queries of the search. Their keys start like those of file lists, so that changes of files refetch them.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { Problem } from "@/api/problem";
import type { components } from "@/api/schema";
import type { File, Mission } from "@/api/types";
import { useRoute, type RouteLocationRaw } from "vue-router";
import { quoted } from "@/components/commands";

type Schemas = components["schemas"];
export type Found = Schemas["SearchRead"];
export type TopicFound = Schemas["TopicFound"];
export type Facet = Schemas["Facet"];
export type FacetValue = Schemas["FacetValue"];
export type Labelled = Schemas["FileLabelled"];
type Sort = Schemas["FileSort"];

const PAGE = 50;
const SORTS: readonly string[] = ["path", "-path", "created", "-created", "size", "-size", "start", "-start"] satisfies Sort[];

/** Returns a sort order that the server accepts for any value in the URL. */
export function sortOf(text: string): Sort {
  return SORTS.includes(text) ? (text as Sort) : "-start";
}

function searchOptions(query: string, sort: Sort) {
  return {
    queryKey: keys.files({ search: query, sort }),
    queryFn: ({ signal }: { signal: AbortSignal }): Promise<Found> =>
      call(api.GET("/api/v1/search", { params: { query: { query, sort, limit: PAGE } }, signal })),
  };
}

/** The results of a query: the first files, missions and topics, and how many there are. */
export function useSearch(query: () => string, sort: () => Sort) {
  return useQuery(computed(() => ({ ...searchOptions(query(), sort()), placeholderData: keepPreviousData })));
}

/** The matching files. The response to the search contains the first page. */
export function useMatchingFiles(text: () => string, sort: () => Sort, enabled: () => boolean) {
  const queries = useQueryClient();
  const filters = () => ({ query: text(), sort: sort(), limit: PAGE });
  return useList<File, ReturnType<typeof filters>>((query) => keys.files({ results: query }), filters, async (query, signal) => {
    if (query.cursor === undefined) return (await queries.query(searchOptions(query.query, query.sort))).files;
    return call(api.GET("/api/v1/files", { params: { query }, signal }));
  }, enabled);
}

export function useMatchingMissions(text: () => string, enabled: () => boolean) {
  const queries = useQueryClient();
  const filters = () => ({ query: text(), sort: "-start" as const, limit: PAGE });
  return useList<Mission, ReturnType<typeof filters>>((query) => keys.files({ missions: query }), filters, async (query, signal) => {
    if (query.cursor === undefined) return (await queries.query(searchOptions(query.query, query.sort))).missions;
    return call(api.GET("/api/v1/missions", { params: { query }, signal }));
  }, enabled);
}

export function useFacets(query: () => string, enabled: () => boolean) {
  return useQuery({
    queryKey: computed(() => keys.files({ facets: query() })),
    queryFn: ({ signal }) => call(api.GET("/api/v1/search/facets", { params: { query: { query: query() } }, signal })),
    placeholderData: keepPreviousData,
    enabled,
  });
}

export function useLabelling() {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: (body: Schemas["LabelChange"]) => call(api.POST("/api/v1/files/labels", { body })),
    onSettled: () => queries.invalidateQueries({ queryKey: ["files"] }),
    meta: { showsItself: true },
  });
}

export interface SyntaxFault {
  readonly column: number;
  readonly expression: string;
  readonly reason: string;
}

/** Returns the syntax error in a query; null for any other error. */
export function syntaxErrorOf(problem: Problem | null): SyntaxFault | null {
  if (problem?.code !== "invalid_query") return null;
  const { column, expression, reason } = problem.document;
  if (typeof column !== "number" || typeof expression !== "string" || typeof reason !== "string") return null;
  return { column, expression, reason };
}

/** Returns a function for the address of this page with another query or tab. */
export function useSearchAddress(): (query: string, tab?: string) => RouteLocationRaw {
  const route = useRoute();
  return (query, tab) => ({
    name: "search",
    query: { ...route.query, ...(tab !== undefined && { tab }), q: query === "" ? undefined : query },
  });
}

/** Returns a script that downloads the results of a query. All user input in it is quoted. */
export function downloadScript(query: string, server: string, head: string): string {
  return [
    "#!/bin/sh",
    `# ${head}`,
    "set -eu",
    `export KLEINKRAM_URL="\${KLEINKRAM_URL:-${server}}"`,
    `exec klein download --nested --query ${quoted(query)} --dest "\${1:-data}"`,
    "",
  ].join("\n");
}

/** Adds a term to a query. */
export function withTerm(query: string, key: string, value: string): string {
  const isPlain = value !== "" && !/[\s"\\]/.test(value);
  const term = isPlain ? value : `"${value.replaceAll("\\", "\\\\").replaceAll('"', '\\"')}"`;
  return `${query} ${key}:${term}`.trim();
}

export interface Marked {
  readonly before: string;
  readonly wrong: string;
  readonly after: string;
}

/** Splits a query at its syntax error. The server counts columns from 1, in characters. */
export function markedAt(text: string, column: number, expression: string): Marked {
  const characters = Array.from(text);
  const rest = characters.slice(column - 1).join("");
  const wrong = expression !== "" && rest.startsWith(expression) ? expression : rest;
  return { before: characters.slice(0, column - 1).join(""), wrong, after: rest.slice(wrong.length) };
}
