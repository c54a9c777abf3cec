/** Computes curves from the fields of messages; `derivation_text.ts` has the texts that name them. */

import { derivationOf } from "./derivation_text";
import { isFields, isNumbers, type Value } from "../decoding/decoder";
import { numberAt, stepsOf, valueAt } from "../decoding/fields";

/** Returns the value of a curve at a message, whose time is `timeNs`; null where it has none. Messages come in order. */
export type Evaluate = (message: Value | null, timeNs: bigint) => number | null;

const COMPONENTS = ["x", "y", "z", "w"];
const NS_PER_S = 1e9;

/** Returns how the curve that a text names is computed. Derivatives remember the previous message. */
export function evaluatorOf(text: string): Evaluate {
  const derivation = derivationOf(text);
  if (derivation === null) return fieldAt(text);
  const [first = "", second = ""] = derivation.parts;
  if (derivation.name === "norm") return normOf(first);
  return derivation.name === "derivative" ? derivativeOf(first) : differenceOf(first, second);
}

function fieldAt(path: string): Evaluate {
  const steps = stepsOf(path) ?? [];
  return (message) => (message === null ? null : numberAt(message, steps));
}

function normOf(path: string): Evaluate {
  const steps = stepsOf(path) ?? []; // the message itself may be the vector
  return (message) => {
    const components = message === null ? [] : componentsOf(valueAt(message, steps));
    return components.length >= 2 && components.every(isNumber) ? Math.hypot(...(components as number[])) : null;
  };
}

/** Returns the components of a vector; none for what is none. */
function componentsOf(vector: Value | undefined): Value[] {
  if (isFields(vector)) return COMPONENTS.flatMap((name) => (Object.hasOwn(vector, name) ? [vector[name] ?? null] : []));
  if (!isNumbers(vector) && !Array.isArray(vector)) return [];
  return vector.length <= COMPONENTS.length ? Array.from<Value>(vector) : [];
}

function isNumber(value: Value): boolean {
  return typeof value === "number" && Number.isFinite(value);
}

function derivativeOf(path: string): Evaluate {
  const valueOf = fieldAt(path);
  let previous: { readonly value: number; readonly timeNs: bigint } | null = null;
  return (message, timeNs) => {
    const value = valueOf(message, timeNs);
    const before = previous;
    previous = value === null ? null : { value, timeNs };
    if (value === null || before === null || timeNs <= before.timeNs) return null;
    return (value - before.value) / (Number(timeNs - before.timeNs) / NS_PER_S);
  };
}

function differenceOf(path: string, other: string): Evaluate {
  const [valueOf, otherOf] = [fieldAt(path), fieldAt(other)];
  return (message, timeNs) => {
    const [value, subtracted] = [valueOf(message, timeNs), otherOf(message, timeNs)];
    return value === null || subtracted === null ? null : value - subtracted;
  };
}
