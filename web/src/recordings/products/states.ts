/** The discrete values of a message: texts, truth values and small whole numbers, by the names of their fields. */

import { fieldTree, stepsOf, valueAt, type FieldNode } from "../decoding/fields";
import type { Value } from "../decoding/decoder";

export type State = string | number | boolean;
export type States = Record<string, State>;

const MAX_STATES = 200;
const MAX_TEXT = 200;
const MAX_NUMBER = 65_535;

/** Return up to 200 discrete values; of texts, the first 200 characters. */
export function statesOf(message: Value): States {
  const paths = pathsOf(fieldTree(message, isDiscrete)).slice(0, MAX_STATES);
  return Object.fromEntries(paths.flatMap((path) => {
    const value = valueAt(message, stepsOf(path) ?? []);
    const state = typeof value === "string" ? value.slice(0, MAX_TEXT) : value;
    return isState(state) ? [[path, state]] : [];
  }));
}

/** Return the names of all fields of a tree. */
function pathsOf(nodes: readonly FieldNode[]): string[] {
  return nodes.flatMap(({ path, children }) => (path === null ? pathsOf(children) : [path]));
}

function isDiscrete(value: Value): boolean {
  if (typeof value === "number") return Number.isInteger(value) && Math.abs(value) <= MAX_NUMBER;
  return typeof value === "string" || typeof value === "boolean";
}

function isState(value: Value | undefined): value is State {
  return typeof value === "string" || typeof value === "number" || typeof value === "boolean";
}
