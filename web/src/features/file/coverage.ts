// Where in a file a topic has messages, as far as its first and last message tell.
import type { File, Topic } from "@/api/types";

const PARTS = 120;

/** Returns for each part of the file's span whether the topic is there: 1 or 0. */
export function coverage(topic: Topic, file: File): number[] {
  const { start_ns: start, end_ns: end } = file;
  const { first_ns: first, last_ns: last } = topic;
  if (start === null || end === null || first === null || last === null) return [];
  const part = Math.max(1, end - start) / PARTS;
  return Array.from({ length: PARTS }, (_, at) => {
    const from = start + at * part;
    const isAtEnd = at === PARTS - 1 && last >= end;
    return first < from + part && (last >= from || isAtEnd) ? 1 : 0;
  });
}
