// Queries of actions, and texts of their definitions.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { components } from "@/api/schema";
import type { Definition, Parameter } from "@/api/types";
import { formatDuration, formatSize, globOf } from "@/components/format";
import { texts as all } from "@/texts/actions";

export type LibraryAction = components["schemas"]["LibraryActionRead"];

const MAX_CHOICES = 500;

export function useActions(name: () => string, archived: () => boolean) {
  const filters = () => ({ archived: archived(), name: globOf(name()) || undefined });
  return useList(keys.actions, filters, (query, signal) => call(api.GET("/api/v1/actions", { params: { query }, signal })));
}

/** The actions to choose from. */
export function useActionChoice() {
  const query = { limit: MAX_CHOICES };
  return useQuery({
    queryKey: keys.actions(query),
    queryFn: ({ signal }) => call(api.GET("/api/v1/actions", { params: { query }, signal })),
  });
}

export function useAction(actionId: () => string) {
  return useQuery({
    queryKey: ["actions", "one", actionId],
    queryFn: ({ signal }) => call(api.GET("/api/v1/actions/{action_id}", { params: { path: { action_id: actionId() } }, signal })),
    enabled: () => actionId() !== "",
  });
}

export function useVersions(actionId: string) {
  const path = { action_id: actionId };
  return useList(() => [...keys.action(actionId), "versions"], {}, (query, signal) =>
    call(api.GET("/api/v1/actions/{action_id}/versions", { params: { path, query }, signal })),
  );
}

export function useArchiving(actionId: string) {
  const queries = useQueryClient();
  const path = { action_id: actionId };
  return useMutation({
    mutationFn: ({ etag, ...body }: { readonly archived: boolean } & EtagCarrier) =>
      call(api.PATCH("/api/v1/actions/{action_id}", { params: { path, header: ifMatch(etag) }, body })),
    onSuccess: (action, { etag }) => noteNewEtag(etag, action.etag),
    // Also after a rejection: another user may have been first.
    onSettled: () => queries.invalidateQueries({ queryKey: ["actions"] }),
  });
}

/** The shipped actions, and which of them a project has; without one, the whole lab. */
export function useLibrary(projectId: () => string | undefined) {
  const query = computed(() => ({ project_id: projectId() }));
  return useQuery({
    // It starts like the key of actions, because their changes change it.
    queryKey: computed(() => ["actions", "library", query.value]),
    queryFn: ({ signal }) => call(api.GET("/api/v1/library", { params: { query: query.value }, signal })),
    placeholderData: keepPreviousData,
  });
}

export function useAddingFromLibrary() {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: ({ name, projectId }: { readonly name: string; readonly projectId: string | null }) =>
      call(api.POST("/api/v1/library/{name}", { params: { path: { name: name.replace(/^kleinkram\//, "") } }, body: { project_id: projectId } })),
    onSettled: () => queries.invalidateQueries({ queryKey: ["actions"] }),
    meta: { showsItself: true },
  });
}

/** The action of the library that a version is from, without the version of Kleinkram; empty for others. */
export function originOf({ library }: Definition): string {
  return (library ?? "").replace(/@.*$/, "");
}

const texts = all.definition;
const NS_PER_S = 1_000_000_000;

/** The number of locked packages, each a text `name==version`; empty without a lock. */
export function lockedOf(packages: readonly string[]): string {
  const names = new Set(packages.map((text) => text.split("==")[0]));
  return names.size > 0 ? texts.locked(names.size) : "";
}

/** The input files, metadata, checks and reference as text. */
export function inputsOf({ inputs }: Definition): string {
  const parts = [
    inputs.paths.length > 0 ? texts.paths(inputs.paths.join(", ")) : "",
    inputs.topics.length > 0 ? texts.topics(inputs.topics.join(", ")) : "",
    inputs.message_types.length > 0 ? texts.types(inputs.message_types.join(", ")) : "",
  ].filter((item) => item !== "");
  const others = [
    inputs.metadata.length > 0 ? texts.metadata(inputs.metadata.join(", ")) : "",
    inputs.checks ? texts.checks : "",
    inputs.reference ? texts.reference : "",
  ].filter((item) => item !== "");
  return [parts.length === 0 ? texts.all : parts.join(", "), ...others].join("; ");
}

/** The resource limits as text. */
export function resourcesOf({ resources }: Pick<Definition, "resources">): string {
  return [
    texts.cores(resources.cores),
    texts.memory(formatSize(resources.memory_bytes)),
    texts.disk(formatSize(resources.disk_bytes)),
    ...(resources.gpus > 0 ? [texts.gpus(resources.gpus)] : []),
    texts.time(formatDuration(resources.time_s * NS_PER_S)),
    ...(resources.labels.length > 0 ? [texts.labels(resources.labels.join(", "))] : []),
  ].join(", ");
}

/** What values a parameter takes, beyond its type. */
export function boundsOf({ minimum, maximum, choices }: Parameter): string {
  if (choices) return choices.join(", ");
  const [least, most] = [minimum ?? null, maximum ?? null];
  if (least !== null && most !== null) return texts.between(least, most);
  if (least !== null) return texts.atLeast(least);
  return most !== null ? texts.atMost(most) : "";
}

/** The default of a parameter as text. */
export function presetOf({ default: preset, unit }: Parameter): string {
  if (preset === null || preset === undefined) return texts.must;
  if (typeof preset === "boolean") return all.launch[preset ? "yes" : "no"].toLowerCase();
  return unit ? `${preset} ${unit}` : String(preset);
}
