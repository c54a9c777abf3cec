/** The value of a message as plain data of bounded size: what a panel needs that knows the message type. */

import { isFields, isNumbers, type Value } from "../decoding/decoder";
import { MAX_DEPTH } from "../limits";

export type PlainValue = number | boolean | string | null | PlainValue[] | { [name: string]: PlainValue };

const MAX_PARTS = 2_000;
const MAX_TEXT = 4_000;

/** Return the value without what exceeds 2,000 values, 4,000 characters of a text, or the depth of messages. */
export function plainValue(value: Value): PlainValue {
  const budget = { parts: MAX_PARTS };
  return plain(value, MAX_DEPTH, budget);
}

function plain(value: Value, depth: number, budget: { parts: number }): PlainValue {
  budget.parts -= 1;
  if (depth === 0) return null;
  if (typeof value === "string") return value.slice(0, MAX_TEXT);
  if (Array.isArray(value) || isNumbers(value)) {
    const items: PlainValue[] = [];
    for (let place = 0; place < value.length && budget.parts > 0; place += 1) items.push(plain(value[place] ?? null, depth - 1, budget));
    return items;
  }
  if (!isFields(value)) return value;
  const fields = Object.create(null) as Record<string, PlainValue>;
  for (const [name, inner] of Object.entries(value)) {
    if (budget.parts <= 0) break;
    fields[name] = plain(inner, depth - 1, budget);
  }
  return { ...fields };
}
