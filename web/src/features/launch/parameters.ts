// The values that somebody gives an action: judged as the server will, while they still type.
import type { Parameter } from "@/api/types";
import { texts as all } from "@/texts/actions";

export type Value = string | number | boolean;
/** What stands in the form: nothing where the default is meant. */
export type Given = Readonly<Record<string, Value | null>>;

const texts = all.launch.wants;

/** Returns what is wrong with a value; null where nothing is. */
export function judgeParameter(parameter: Parameter, value: Value | null | undefined): string | null {
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

/** Returns what is wrong with each parameter. */
export function judgeAll(parameters: readonly Parameter[], given: Given): ReadonlyMap<string, string> {
  return new Map(parameters.flatMap((each) => {
    const wrong = judgeParameter(each, given[each.name]);
    return wrong === null ? [] : [[each.name, wrong] as const];
  }));
}

/** Returns what is sent: the values that were given, no defaults. */
export function sent(parameters: readonly Parameter[], given: Given): Record<string, Value> {
  return Object.fromEntries(parameters.flatMap(({ name }) => {
    const value = given[name] ?? null;
    return value === null || value === "" ? [] : [[name, value] as const];
  }));
}
