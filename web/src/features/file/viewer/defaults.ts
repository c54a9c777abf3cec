// What is shown first: of a recording the topic, of a topic the fields.
import type { Topic } from "@/api/types";
import type { FieldNode } from "@/recordings/decoding/fields";
import { MOST_CURVES } from "@/recordings/limits";
import { isPictureType } from "@/recordings/pictures/picture";

/** What of well-known types one wants to see first. */
const FIRST: readonly (readonly [RegExp, readonly string[]])[] = [
  [/[/.]Imu$/, ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]],
  [/[/.]NavSatFix$/, ["altitude"]],
  [/[/.]Odometry$/, ["pose.pose.position.x", "pose.pose.position.y", "pose.pose.position.z"]],
  [/[/.]JointState$/, ["position[0]", "position[1]", "position[2]"]],
];
const NOT_FIRST = /(^|\.)(header|stamp|timestamp|seq|sec|nanosec|nsec)(\.|$)|covariance/;
const FEW = 4;

/** Returns the topic to show: the wanted one if it is there, else the first with pictures, else the busiest. */
export function chosenTopic(topics: readonly Topic[], wanted: string): Topic | null {
  const found = topics.find(({ name }) => name === wanted);
  if (found !== undefined) return found;
  const filled = topics.filter(({ count }) => count !== 0);
  const pictures = filled.find(({ message_type }) => isPictureType(message_type));
  const busiest = filled.toSorted((a, b) => (b.count ?? 0) - (a.count ?? 0))[0];
  return pictures ?? busiest ?? topics[0] ?? null;
}

/** Returns the names of all fields of a tree. */
export function leaves(nodes: readonly FieldNode[]): string[] {
  return nodes.flatMap((node) => (node.path === null ? leaves(node.children) : [node.path]));
}

/** Returns the fields to plot: those wanted that are there, else what one wants to see first of such messages. */
export function chosenFields(nodes: readonly FieldNode[], wanted: readonly string[], messageType: string | null): string[] {
  const all = leaves(nodes);
  const found = wanted.filter((field) => all.includes(field)).slice(0, MOST_CURVES);
  if (found.length > 0) return found;
  const known = FIRST.find(([type]) => type.test(messageType ?? ""))?.[1].filter((field) => all.includes(field)) ?? [];
  if (known.length > 0) return known;
  return groups(nodes).find((group) => group.every((field) => !NOT_FIRST.test(field)))?.slice(0, FEW) ?? all.slice(0, 1);
}

/** The fields that stand together, by group, outer ones first. */
function groups(nodes: readonly FieldNode[]): string[][] {
  const own = nodes.flatMap(({ path }) => (path === null ? [] : [path]));
  const plain = own.filter((field) => !NOT_FIRST.test(field));
  const inner = nodes.flatMap(({ children }) => groups(children));
  return plain.length > 0 ? [plain, ...inner] : inner;
}
