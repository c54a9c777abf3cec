// Queries of the search. Their keys start like those of file lists, so that changes of files refetch them.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys, usePages } from "@/api/queries";
import type { Problem } from "@/api/problem";
import type { components } from "@/api/schema";
import type { File, Mission } from "@/api/types";
import { useRoute, type RouteLocationRaw } from "vue-router";
import { quoted, type Commands } from "@/features/file/commands";

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

function parameters(query: string, sort: Sort) {
  return {
    queryKey: keys.files({ search: query, sort }),
    queryFn: ({ signal }: { signal: AbortSignal }): Promise<Found> =>
      call(api.GET("/api/v1/search", { params: { query: { query, sort, limit: PAGE } }, signal })),
  };
}

/** What a text finds: the first of each, and how many there are. */
export function useFound(query: () => string, sort: () => Sort) {
  return useQuery(computed(() => ({ ...parameters(query(), sort()), placeholderData: keepPreviousData })));
}

/** The files that a text finds, from the first that came with the search on. */
export function useFilesFound(query: () => string, sort: () => Sort, enabled: () => boolean) {
  const queries = useQueryClient();
  return usePages<File>(() => keys.files({ results: query(), sort: sort() }), async (cursor, signal) => {
    if (cursor === undefined) return (await queries.query(parameters(query(), sort()))).files;
    return call(api.GET("/api/v1/files", { params: { query: { query: query(), sort: sort(), limit: PAGE, cursor } }, signal }));
  }, { enabled });
}

export function useMissionsFound(query: () => string, enabled: () => boolean) {
  const queries = useQueryClient();
  return usePages<Mission>(() => keys.files({ missions: query() }), async (cursor, signal) => {
    if (cursor === undefined) return (await queries.query(parameters(query(), "-start"))).missions;
    return call(api.GET("/api/v1/missions", { params: { query: { query: query(), sort: "-start", limit: PAGE, cursor } }, signal }));
  }, { enabled });
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

export interface Wrong {
  readonly column: number;
  readonly expression: string;
  readonly reason: string;
}

/** Returns what is wrong with the text itself; null for any other failure. */
export function wrongOf(problem: Problem | null): Wrong | null {
  if (problem?.code !== "invalid_query") return null;
  const { column, expression, reason } = problem.document;
  if (typeof column !== "number" || typeof expression !== "string" || typeof reason !== "string") return null;
  return { column, expression, reason };
}

/** Returns what gives the address of this view with another text, or of another tab of it. */
export function useAddress(): (query: string, tab?: string) => RouteLocationRaw {
  const route = useRoute();
  return (query, tab) => ({
    name: "search",
    query: { ...route.query, ...(tab !== undefined && { tab }), q: query === "" ? undefined : query },
  });
}

/** Returns the commands that search by a text. */
export function searchCommands(query: string): Commands {
  const sdk = [
    "import kleinkram",
    "",
    "with kleinkram.connect() as client:",
    `    for file in client.files.list(${JSON.stringify(query)}):`,
    "        print(file.mission.name, file.path, file.size_bytes)",
  ].join("\n");
  return { cli: `klein search ${query.startsWith("-") ? "-- " : ""}${quoted(query)}`, sdk };
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

/** Returns a text with one term more. */
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

/** Returns a text parted at what is wrong in it. The server counts columns from 1, by characters. */
export function markedAt(text: string, column: number, expression: string): Marked {
  const characters = Array.from(text);
  const rest = characters.slice(column - 1).join("");
  const wrong = expression !== "" && rest.startsWith(expression) ? expression : rest;
  return { before: characters.slice(0, column - 1).join(""), wrong, after: rest.slice(wrong.length) };
}
