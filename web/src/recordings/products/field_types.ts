/** The types of the fields of a message by its definition, and the names that the definition has for their values. */

import type { MessageDefinition, MessageDefinitionField } from "@foxglove/message-definition";
import { rosDefinitions } from "../decoding/definitions";
import type { Schema } from "../formats/recording";
import { MAX_DEPTH } from "../limits";

export interface FieldType {
  type: string;
  /** Names of constants by the value as text. */
  names: Record<string, string>;
}

/** By the name of the field, without the places of elements: `status.status`, `joints[].mode`. */
export type FieldTypes = Record<string, FieldType>;

const MAX_TYPES = 2_000;

/** Return the types of a ROS message; null where it has no definition that can be parsed. */
export function fieldTypes(schema: Schema): FieldTypes | null {
  const definitions = rosDefinitions(schema);
  return definitions?.[0] === undefined ? null : typesOf(definitions, definitions[0]);
}

function typesOf(definitions: readonly MessageDefinition[], root: MessageDefinition): FieldTypes {
  const byName = new Map(definitions.map((one) => [one.name ?? "", one]));
  const types = Object.create(null) as FieldTypes;
  let typesLeft = MAX_TYPES;

  function visit({ definitions: fields }: MessageDefinition, prefix: string, depth: number): void {
    const names = constantNames(fields);
    for (const field of fields) {
      if (field.isConstant === true || (typesLeft -= 1) < 0) continue;
      const path = `${prefix}${field.name}${field.isArray === true ? "[]" : ""}`;
      const inner = field.isComplex === true ? byName.get(field.type) : undefined;
      if (inner === undefined) types[path] = { type: field.type, names: names.get(field.name) ?? {} };
      else if (depth > 0) visit(inner, `${path}.`, depth - 1);
    }
  }

  visit(root, "", MAX_DEPTH);
  return { ...types };
}

/** Return the names of values by field.
 *
 * ROS does not say which constants belong to which field. Those that begin with the name of a field are its own. Other
 * constants belong to the next field of their type, or to the last one before them where none follows.
 */
function constantNames(fields: readonly MessageDefinitionField[]): Map<string, Record<string, string>> {
  const plain = fields.filter(({ isConstant, isComplex }) => isConstant !== true && isComplex !== true);
  const byField = new Map<string, MessageDefinitionField[]>();
  for (const [place, constant] of fields.entries()) {
    if (constant.isConstant !== true || typeof constant.value === "string") continue;
    const sameType = plain.filter(({ type }) => type === constant.type);
    const prefixed = sameType.filter(({ name }) => constant.name.startsWith(`${name.toUpperCase()}_`)).toSorted((a, b) => b.name.length - a.name.length)[0];
    const next = sameType.find((field) => fields.indexOf(field) > place);
    const owner = prefixed ?? next ?? sameType.at(-1);
    if (owner !== undefined) byField.set(owner.name, [...(byField.get(owner.name) ?? []), constant]);
  }
  return new Map([...byField].map(([field, constants]) => [field, namesOf(constants)]));
}

/** Names by value; a value that several constants have is named by all of them. */
function namesOf(constants: readonly MessageDefinitionField[]): Record<string, string> {
  const names: Record<string, string> = {};
  for (const { name, value } of constants) {
    const text = String(value);
    names[text] = names[text] === undefined ? name : `${names[text]}, ${name}`;
  }
  return names;
}
