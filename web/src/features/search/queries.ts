// What the search asks the server. Its keys begin as lists of files do, since it is old when they are.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import { usePages } from "@/api/pages";
import type { Problem } from "@/api/problem";
import type { components } from "@/api/schema";
import type { File, Mission } from "@/api/types";

type Schemas = components["schemas"];
export type Found = Schemas["SearchRead"];
export type TopicFound = Schemas["TopicFound"];
export type Facet = Schemas["Facet"];
export type FacetValue = Schemas["FacetValue"];
export type Labelled = Schemas["FileLabelled"];
type Sort = Schemas["FileSort"];

const PAGE = 50;
const SORTS: readonly string[] = ["path", "-path", "created", "-created", "size", "-size", "start", "-start"] satisfies Sort[];

/** Returns an order as the server knows it, whatever stands in the address. */
export function sortOf(text: string): Sort {
  return SORTS.includes(text) ? (text as Sort) : "-start";
}

function asked(query: string, sort: Sort) {
  return {
    queryKey: keys.files({ search: query, sort }),
    queryFn: ({ signal }: { signal: AbortSignal }): Promise<Found> =>
      call(api.GET("/api/v1/search", { params: { query: { query, sort, limit: PAGE } }, signal })),
  };
}

/** What a text finds: the first of each, and how many there are. */
export function useFound(query: () => string, sort: () => Sort) {
  return useQuery(computed(() => ({ ...asked(query(), sort()), placeholderData: keepPreviousData })));
}

/** The files that a text finds, from the first that came with the search on. */
export function useFilesFound(query: () => string, sort: () => Sort, enabled: () => boolean) {
  const queries = useQueryClient();
  return usePages<File>(() => keys.files({ found: query(), sort: sort() }), async (cursor, signal) => {
    if (cursor === undefined) return (await queries.query(asked(query(), sort()))).files;
    return call(api.GET("/api/v1/files", { params: { query: { query: query(), sort: sort(), limit: PAGE, cursor } }, signal }));
  }, { enabled });
}

export function useMissionsFound(query: () => string, enabled: () => boolean) {
  const queries = useQueryClient();
  return usePages<Mission>(() => keys.files({ missions: query() }), async (cursor, signal) => {
    if (cursor === undefined) return (await queries.query(asked(query(), "-start"))).missions;
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
