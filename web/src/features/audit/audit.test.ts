import { describe, expect, it } from "vitest";
import { eventTextOf, differences, actorOf, exportAddress, objectNameOf, placeOf, queryOf } from "./queries";
import type { AuditEvent } from "@/api/types";
import { globOf } from "@/components/format";
import { startOfDay } from "@/components/time";

const event: AuditEvent = {
  id: 1, at: "2026-11-21T20:00:00Z", actor: { id: "a", name: "Ada" }, token: null, share: null, session_id: null, address: null,
  as_admin: false, operation: "project.update", resource_type: "project", resource_id: "p", resource_name: "alpine", project_id: "p",
  mission_id: null, before: {}, after: {}, request_id: "r",
};

describe("differences", () => {
  it("tells what came, went and changed, and not what stayed", () => {
    expect(differences({ name: "a", gone: 1, same: true }, { name: "b", come: null, same: true })).toEqual([
      { field: "come", before: null, after: "null" },
      { field: "gone", before: "1", after: null },
      { field: "name", before: "a", after: "b" },
    ]);
  });
  it("tells mappings by the path of what is in them", () => {
    expect(differences({ fields: { robot: { type: "text" } } }, { fields: { robot: { type: "number" } } })).toEqual([
      { field: "fields.robot.type", before: "text", after: "number" },
    ]);
  });
  it("shows lists as people read them, and empty mappings as what they are", () => {
    expect(differences({}, { labels: ["a", "b"], limits: [1, null], more: {} })).toEqual([
      { field: "labels", before: null, after: "a, b" },
      { field: "limits", before: null, after: "[1,null]" },
      { field: "more", before: null, after: "{}" },
    ]);
  });
});

it("says who did it, where that is known", () => {
  expect(actorOf(event)).toBe("Ada");
  expect(actorOf({ ...event, actor: null, share: { id: "s", name: "review" } })).toBe("Link review");
  expect(actorOf({ ...event, actor: null, request_id: null })).toBe("Kleinkram");
  expect(actorOf({ ...event, actor: null, address: "10.0.0.1" })).toBe("Unknown person");
});

it("says what was done, and the name of an act that it does not know", () => {
  expect(eventTextOf(event)).toBe("changed");
  expect(eventTextOf({ ...event, operation: "toString" })).toBe("toString");
});

it("says what an admin saw of the whole server", () => {
  const viewed = { ...event, operation: "admin.read", resource_type: "server", resource_name: "list_people" };
  expect(`${eventTextOf(viewed)} ${objectNameOf(viewed)}`).toBe("viewed as an admin the list of people");
  expect(objectNameOf({ ...viewed, resource_type: "project", resource_name: "list_people" })).toBe("list_people");
  expect(objectNameOf({ ...viewed, resource_name: "get_what_is_new" })).toBe("get_what_is_new");
});

it("finds parts of names, and leaves patterns alone", () => {
  expect([globOf(" ada "), globOf("ada*"), globOf(" ")]).toEqual(["*ada*", "ada*", ""]);
});

it("leads to what has a page", () => {
  expect(placeOf(event)).toEqual({ name: "project", params: { projectId: "p" } });
  expect(placeOf({ ...event, resource_type: "token" })).toBeNull();
  expect(placeOf({ ...event, resource_id: null })).toBeNull();
});

it("does not say a name twice of who signs in", () => {
  expect(objectNameOf(event)).toBe("alpine");
  expect(objectNameOf({ ...event, resource_type: "session", resource_name: "Ada" })).toBe("");
});

it("asks for what the address says, and for nothing that says nothing", () => {
  expect(queryOf({ person: "ada", resource_type: "", until: "2026-11-21", as_admin: "yes", token_id: "t", other: "x" })).toEqual({
    person: "*ada*", until: startOfDay("2026-11-22"), as_admin: true, token_id: "t",
  });
});

it("does not take for a day what is none", () => {
  expect(queryOf({ since: "yesterday", until: ["a", "b"] })).toEqual({});
});

it("exports what is shown", () => {
  expect(exportAddress({ person: "*a&b*", as_admin: true })).toBe("/api/v1/audit/export?person=*a%26b*&as_admin=true");
});
