/** Messages of ROS 1 and ROS 2, by the definitions that the recording carries. No code is generated: the page forbids it. */

import type { MessageDefinition, MessageDefinitionField } from "@foxglove/message-definition";
import { parse } from "@foxglove/rosmsg";
import { failureOf, ReadFailure } from "../failures";
import { MOST_DEPTH, MOST_VALUES } from "../limits";
import { kindOf, RosReader } from "./ros_reader";
import type { Decode, Value } from "./value";

interface Field {
  name: string;
  read: (reader: RosReader, budget: Budget) => Value;
}

/** What of one message is decoded at most. */
interface Budget {
  values: number;
  depth: number;
}

/** Return how to decode messages of a definition; `ros` is that of the definition, `aligned` is CDR.
 *
 * @throws ReadFailure definition_unreadable.
 */
export function rosDecoder(definition: string, ros: 1 | 2, aligned: boolean): Decode {
  let definitions: MessageDefinition[];
  try {
    definitions = parse(definition, { ros2: ros === 2 });
  } catch (thrown) {
    throw failureOf(thrown, "definition_unreadable");
  }
  const [root] = definitions;
  if (root === undefined) throw new ReadFailure("definition_unreadable", "it is empty");
  const structure = new Structures(definitions, aligned).of(root);
  return (data) => structure(new RosReader(data, aligned), { values: MOST_VALUES, depth: MOST_DEPTH });
}

/** Readers of structures, each made once; a type may hold itself only in arrays that end. */
class Structures {
  private readonly byName = new Map<string, MessageDefinition>();
  private readonly made = new Map<MessageDefinition, Field[]>();

  constructor(
    definitions: readonly MessageDefinition[],
    private readonly aligned: boolean,
  ) {
    for (const definition of definitions) if (definition.name !== undefined) this.byName.set(definition.name, definition);
  }

  of(definition: MessageDefinition): Field["read"] {
    let fields = this.made.get(definition);
    if (fields === undefined) {
      fields = [];
      this.made.set(definition, fields); // before its fields, which may lead back to it
      for (const field of definition.definitions) {
        if (field.isConstant !== true) fields.push({ name: field.name, read: this.field(field) });
      }
    }
    const known = fields;
    return (reader, budget) => this.structure(known, reader, budget);
  }

  private structure(fields: readonly Field[], reader: RosReader, budget: Budget): Value {
    if (budget.depth === 0) throw new ReadFailure("message_damaged", "it nests too deep");
    budget.depth -= 1;
    if (fields.length === 0 && this.aligned) reader.skip(1); // ROS 2 writes one byte for an empty structure
    const value: Record<string, Value> = Object.create(null) as Record<string, Value>;
    for (const { name, read } of fields) value[name] = read(reader, budget);
    budget.depth += 1;
    return value;
  }

  private field(field: MessageDefinitionField): Field["read"] {
    const kind = kindOf(field.type);
    if (field.isArray !== true) return kind === undefined ? this.single(field) : (reader) => reader.one(kind);
    const { arrayLength } = field;
    const count = (reader: RosReader): number => (typeof arrayLength === "number" ? arrayLength : reader.count());
    if (kind !== undefined) return (reader) => reader.many(kind, count(reader));
    const element = this.single(field);
    return (reader, budget) => {
      const length = count(reader);
      budget.values -= length;
      if (budget.values < 0) throw new ReadFailure("message_damaged", "it holds too many values");
      return Array.from({ length }, () => element(reader, budget));
    };
  }

  private single(field: MessageDefinitionField): Field["read"] {
    if (field.type === "string") return (reader) => reader.string();
    if (field.type === "time" || field.type === "duration") {
      const isSigned = this.aligned || field.type === "duration";
      return (reader) => reader.time(isSigned);
    }
    const definition = this.byName.get(field.type);
    if (definition === undefined) throw new ReadFailure("definition_unreadable", field.type);
    return this.of(definition);
  }
}
