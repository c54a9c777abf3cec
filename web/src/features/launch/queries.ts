// Queries of the launch page, and validation of parameters.
import { keepPreviousData, useQuery } from "@tanstack/vue-query";
import { computed, type ComputedRef } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { Mission, Parameter } from "@/api/types";
import { texts as all } from "@/texts/actions";

const MAX_TOPICS = 500;

/** The missions in the URL, without those that do not exist or that the user cannot see. */
export function useMissionsNamed(ids: () => readonly string[]) {
  return useQuery({
    queryKey: ["missions", "named", ids],
    queryFn: async ({ signal }): Promise<readonly Mission[]> => {
      const requests = ids().map((id) => call(api.GET("/api/v1/missions/{mission_id}", { params: { path: { mission_id: id } }, signal })));
      return (await Promise.allSettled(requests)).flatMap((item) => (item.status === "fulfilled" ? [item.value] : []));
    },
    placeholderData: keepPreviousData,
  });
}

/** The names of the topics of a mission. */
export function useTopicNames(missionId: () => string | undefined): ComputedRef<readonly string[]> {
  const matching = useQuery({
    queryKey: computed(() => [...keys.mission(missionId() ?? ""), "topic-names"]),
    queryFn: ({ signal }) => {
      const params = { path: { mission_id: missionId() ?? "" }, query: { limit: MAX_TOPICS, bins: 0 } };
      return call(api.GET("/api/v1/missions/{mission_id}/topics", { params, signal }));
    },
    enabled: () => missionId() !== undefined,
  });
  return computed(() => [...new Set((matching.data.value?.items ?? []).map(({ name }) => name))]);
}

export type Value = string | number | boolean;
/** The values of the form; null means the default. */
export type ParameterValues = Readonly<Record<string, Value | null>>;

const texts = all.launch.wants;

/** Returns the error of a value; null if it is valid. */
export function validateParameter(parameter: Parameter, value: Value | null | undefined): string | null {
  if (value === null || value === undefined || value === "") {
    return (parameter.default ?? null) === null ? texts.must : null;
  }
  if (parameter.type !== "integer" && parameter.type !== "number") return null;
  if (typeof value !== "number" || !Number.isFinite(value)) return texts[parameter.type];
  if (parameter.type === "integer" && !Number.isInteger(value)) return texts.integer;
  const [least, most] = [parameter.minimum ?? null, parameter.maximum ?? null];
  if (least !== null && value < least) return texts.atLeast(least);
  return most !== null && value > most ? texts.atMost(most) : null;
}

/** Returns the errors by parameter. */
export function validateParameters(parameters: readonly Parameter[], values: ParameterValues): ReadonlyMap<string, string> {
  return new Map(parameters.flatMap((item) => {
    const wrong = validateParameter(item, values[item.name]);
    return wrong === null ? [] : [[item.name, wrong] as const];
  }));
}

/** Returns the values to send: those that were entered, no defaults. */
export function sent(parameters: readonly Parameter[], values: ParameterValues): Record<string, Value> {
  return Object.fromEntries(parameters.flatMap(({ name }) => {
    const value = values[name] ?? null;
    return value === null || value === "" ? [] : [[name, value] as const];
  }));
}
