// A message as JSON, from its tree.
import type { TreeNode } from "@/recordings/products/tree";

type Json = string | number | boolean | null | Json[] | { [name: string]: Json };

const NUMERIC = /^(u?int(8|16|32)|float(32|64)|byte|char|octet|number|time|duration)$/;

/** Returns the shown part of a message as JSON; numbers that JSON cannot express are texts. */
export function messageJson(nodes: readonly TreeNode[]): string {
  return JSON.stringify(groupOf("", nodes), null, 2);
}

function groupOf(type: string, nodes: readonly TreeNode[]): Json {
  const isArray = type.endsWith("]");
  if (isArray) return nodes.map(valueOf);
  return Object.fromEntries(nodes.map((node) => [node.label, valueOf(node)]));
}

function valueOf({ type, text, children }: TreeNode): Json {
  if (text === null) return groupOf(type, children);
  if (type === "bool" || type === "boolean") return text === "true" || text === "1";
  if (type === "null") return null;
  const number = Number(text);
  return NUMERIC.test(type) && Number.isFinite(number) ? number : text;
}
