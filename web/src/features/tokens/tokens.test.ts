import { describe, expect, it } from "vitest";
import { ending, isContained, isReady, requestOf, scopesOf, type Draft } from "./queries";
import type { Token } from "@/api/types";

const draft: Draft = { name: " anymal-3 ", kind: "robot", scopes: ["upload"], projectIds: ["p"], missionIds: [], until: null, labels: "" };

describe("a draft of a token", () => {
  it("is ready once it has a name, something that it may, and a robot's limits", () => {
    expect(isReady(draft)).toBe(true);
    expect(isReady({ ...draft, name: " " })).toBe(false);
    expect(isReady({ ...draft, scopes: [] })).toBe(false);
    expect(isReady({ ...draft, projectIds: [] })).toBe(false);
    expect(isReady({ ...draft, projectIds: [], kind: "personal" })).toBe(true);
  });
  it("is sent without what is contained anyway", () => {
    expect(requestOf({ ...draft, scopes: ["read", "write", "run"] })).toMatchObject({ name: "anymal-3", scopes: ["write", "run"] });
  });
  it("of a runner is limited to projects and labels", () => {
    const sent = requestOf({ ...draft, kind: "runner", labels: " gpu, ,site=zurich " });
    expect(sent).toMatchObject({ scopes: ["run"], project_ids: ["p"], runner_labels: ["gpu", "site=zurich"] });
  });
  it("has no end only where that was chosen", () => {
    expect(requestOf(draft)).toMatchObject({ expires_at: null, no_end: true });
    expect(requestOf({ ...draft, until: "2027-01-01T00:00:00Z" })).toMatchObject({ no_end: false });
  });
});

it("no robot is an admin", () => {
  expect(scopesOf("robot").offered).not.toContain("admin");
  expect(isContained("read", ["admin"])).toBe(true);
  expect(isContained("admin", ["write"])).toBe(false);
});

it("a token has ended when it was revoked, or its time is over", () => {
  const token = { revoked_at: null, expires_at: "2026-11-21T00:00:00Z" } as Token;
  expect(ending(token, new Date("2026-11-20T23:59:59Z"))).toBeNull();
  expect(ending(token, new Date("2026-11-21T00:00:00Z"))).toBe("expired");
  expect(ending({ ...token, revoked_at: "2026-11-01T00:00:00Z" }, new Date("2026-11-20"))).toBe("revoked");
});
