import { expect, it } from "vitest";
import { holderOf, sourceOf } from "./queries";
import type { Access } from "@/api/types";

const ada = { id: "a", name: "Ada" };
const access: Access = { person: ada, to: { kind: "person", ...ada }, right: "WRITE", through: "project grant", grant_id: "g", expires_at: null };
const team = { kind: "group" as const, id: "t", name: "field-team" };

it("names who has a right, and what gives it", () => {
  expect([holderOf(access), sourceOf(access)]).toEqual(["Ada", "Right on the project"]);
  expect([holderOf({ ...access, to: team }), sourceOf({ ...access, to: team })]).toEqual(["Ada", "Right on the project, as a member of field-team"]);
});

it("says so where nobody in particular has it, or nobody is known", () => {
  expect(holderOf({ ...access, person: null, to: team })).toBe("Members of field-team");
  expect(holderOf({ ...access, person: null, to: { kind: "email", id: null, name: "eve@x.example" } })).toBe("Owner of eve@x.example");
  expect(holderOf({ ...access, person: null, to: null, through: "public" })).toBe("Everyone, without an account");
  expect(holderOf({ ...access, person: null, to: null, through: "admin" })).toBe("All admins");
});
