import { expect, it } from "vitest";
import { queryOf, exportAddress } from "./queries";
import { startOfDay } from "@/components/time";

it("asks for what the address says, and for nothing that says nothing", () => {
  expect(queryOf({ person: "ada", noun: "", until: "2026-11-21", as_admin: "yes", token_id: "t", other: "x" })).toEqual({
    person: "*ada*", until: startOfDay("2026-11-22"), as_admin: true, token_id: "t",
  });
});

it("does not take for a day what is none", () => {
  expect(queryOf({ since: "yesterday", until: ["a", "b"] })).toEqual({});
});

it("exports what is shown", () => {
  expect(exportAddress({ person: "*a&b*", as_admin: true })).toBe("/api/v1/audit/export?person=*a%26b*&as_admin=true");
});
