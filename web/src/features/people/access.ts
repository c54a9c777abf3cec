// What a way to a right says, in words.
import type { Access } from "@/api/types";
import { texts } from "@/texts/people";

/** Returns who has it by that. */
export function holderOf(access: Access): string {
  if (access.person !== null) return access.person.name;
  if (access.to === null) return access.through === "admin" ? texts.access.admins : texts.access.everybody;
  if (access.to.kind === "email") return texts.access.address(access.to.name);
  return access.to.kind === "group" ? texts.access.members(access.to.name) : access.to.name;
}

/** Returns what gives it to them. */
export function sourceOf(access: Access): string {
  const through = texts.access.through[access.through];
  if (access.to === null) return through;
  const how = access.to.kind === "group" && access.person !== null ? texts.access.byGroup(access.to.name) : "";
  return how === "" ? through : `${through}, ${how}`;
}
