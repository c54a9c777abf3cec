/** The fields of a message: the tree of fields, their paths, and access by path. */

import { MAX_DEPTH, MAX_ELEMENTS, MAX_FIELDS } from "../limits";
import { isFields, isNumbers, type Value } from "./decoder";

export type Step = string | number;

/** A node of the tree of fields: a value (`path`), or a group of others. */
export interface FieldNode {
  label: string;
  /** What the field is called, such as `pose.position.x` or `covariance[0]`; null for a group. */
  path: string | null;
  children: FieldNode[];
  /** Elements of an array that are not offered. */
  hidden: number;
}

const PLAIN = /^[A-Za-z_][A-Za-z0-9_]*$/;
const STEP = /\.?([A-Za-z_][A-Za-z0-9_]*)|\[(\d{1,9})\]|\[("(?:[^"\\]|\\.)*")\]/y;

/** Whether a value is offered as a field. */
type IsField = (value: Value) => boolean;

function isNumeric(value: Value): boolean {
  return typeof value === "number" || typeof value === "boolean";
}

/** Return the fields of a message, up to MAX_FIELDS; the numeric ones if absent. Arrays have their first elements. */
export function fieldTree(value: Value, isField: IsField = isNumeric): FieldNode[] {
  const budget = { fields: MAX_FIELDS, isField };
  return children(value, "", MAX_DEPTH, budget).nodes;
}

function children(value: Value, prefix: string, depth: number, budget: { fields: number; isField: IsField }): { nodes: FieldNode[]; hidden: number } {
  if (depth === 0) return { nodes: [], hidden: 0 };
  const [entries, hidden] = entriesOf(value);
  const nodes: FieldNode[] = [];
  for (const [step, inner] of entries) {
    if (budget.fields <= 0) break;
    const path = prefix + stepText(step, prefix === "");
    if (budget.isField(inner)) {
      budget.fields -= 1;
      nodes.push({ label: label(step), path, children: [], hidden: 0 });
      continue;
    }
    const under = children(inner, path, depth - 1, budget);
    if (under.nodes.length > 0) nodes.push({ label: label(step), path: null, children: under.nodes, hidden: under.hidden });
  }
  return { nodes, hidden };
}

function entriesOf(value: Value): [[Step, Value][], number] {
  if (isNumbers(value) || Array.isArray(value)) {
    const shown = Math.min(value.length, MAX_ELEMENTS);
    const entries = Array.from({ length: shown }, (_, place): [Step, Value] => [place, value[place] ?? null]);
    return [entries, value.length - shown];
  }
  return [isFields(value) ? Object.entries(value) : [], 0];
}

function label(step: Step): string {
  return typeof step === "number" ? `[${step}]` : step;
}

function stepText(step: Step, isFirst: boolean): string {
  if (typeof step === "number") return `[${step}]`;
  if (!PLAIN.test(step)) return `[${JSON.stringify(step)}]`;
  return isFirst ? step : `.${step}`;
}

/** Return the steps of a field's name; null where it is not one. */
export function stepsOf(path: string): Step[] | null {
  const steps: Step[] = [];
  for (let at = 0; at < path.length; at = STEP.lastIndex) {
    STEP.lastIndex = at;
    const match = STEP.exec(path);
    if (match === null) return null;
    const [, name, place, quoted] = match;
    if (name !== undefined) steps.push(name);
    else if (place !== undefined) steps.push(Number(place));
    else steps.push(unquoted(quoted ?? '""'));
  }
  return steps.length > 0 ? steps : null;
}

function unquoted(text: string): string {
  try {
    return String(JSON.parse(text));
  } catch {
    return text;
  }
}

/** Return the value at the end of the steps; undefined where there is none. */
export function valueAt(value: Value, steps: readonly Step[]): Value | undefined {
  let here: Value | undefined = value;
  for (const step of steps) {
    if (typeof step === "number") here = Array.isArray(here) || isNumbers(here) ? here[step] : undefined;
    else here = isFields(here) && Object.hasOwn(here, step) ? here[step] : undefined;
  }
  return here;
}

/** Return the number at the end of the steps; null where there is none, or none that is finite. */
export function numberAt(value: Value, steps: readonly Step[]): number | null {
  const here = valueAt(value, steps);
  if (typeof here === "boolean") return here ? 1 : 0;
  return typeof here === "number" && Number.isFinite(here) ? here : null;
}
