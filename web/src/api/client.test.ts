import { afterEach, beforeEach, describe, expect, it, test, vi } from "vitest";
import { api, call, ifMatch, isSignInRequired, noteNewEtag, noteSignedIn, finishSignIn, readWithLink, signInAddress } from "./client";
import { Problem } from "./problem";

const ENDED = { type: "x", title: "x", status: 401, detail: "The session has ended.", code: "not_authenticated" };
const fetched = vi.fn<(request: Request) => Promise<Response>>();

function json(status: number, body: unknown): Response {
  return new Response(JSON.stringify(body), { status, headers: { "Content-Type": "application/json" } });
}

beforeEach(() => vi.stubGlobal("fetch", fetched));
afterEach(() => {
  noteSignedIn(false);
  finishSignIn(false);
  fetched.mockReset();
  vi.unstubAllGlobals();
});

function make(): Promise<unknown> {
  return call(api.POST("/api/v1/projects", { body: { name: "Alps", description: "" } }));
}

describe("a session that ends while somebody works", () => {
  it("holds what was asked until they signed in again, then asks it anew, whole", async () => {
    noteSignedIn(true);
    const bodies: string[] = [];
    fetched.mockImplementation(async (request) => {
      bodies.push(await request.text());
      return bodies.length === 1 ? json(401, ENDED) : json(201, { id: "1" });
    });
    const made = make();
    await vi.waitFor(() => expect(isSignInRequired.value).toBe(true));
    finishSignIn(true);
    expect(await made).toEqual({ id: "1" });
    expect(bodies[1]).toBe(bodies[0]);
    expect(JSON.parse(bodies[1] ?? "")).toEqual({ name: "Alps", description: "" });
    expect(isSignInRequired.value).toBe(false);
  });
  it("fails what was asked where they decline", async () => {
    noteSignedIn(true);
    fetched.mockImplementation(() => Promise.resolve(json(401, ENDED)));
    const made = make();
    await vi.waitFor(() => expect(isSignInRequired.value).toBe(true));
    finishSignIn(false);
    await expect(made).rejects.toMatchObject({ code: "not_authenticated" });
  });
});

it("does not ask to sign in again where a password was wrong", async () => {
  noteSignedIn(true);
  fetched.mockImplementation(() => Promise.resolve(json(401, { ...ENDED, code: "sign_in_failed" })));
  await expect(make()).rejects.toMatchObject({ code: "sign_in_failed" });
  expect(isSignInRequired.value).toBe(false);
});

it("does not ask a stranger to sign in again", async () => {
  fetched.mockImplementation(() => Promise.resolve(json(401, ENDED)));
  await expect(make()).rejects.toBeInstanceOf(Problem);
  expect(isSignInRequired.value).toBe(false);
});

it("sends the secret of a share link in a header alone, and no cookies", async () => {
  readWithLink("secret");
  fetched.mockImplementation(() => Promise.resolve(json(200, {})));
  await call(api.GET("/api/v1/share"));
  readWithLink(null);
  await call(api.GET("/api/v1/share"));
  const [shared, own] = fetched.mock.calls.map(([request]) => request);
  expect([shared?.headers.get("Authorization"), shared?.credentials, shared?.url.includes("secret")]).toEqual(["Bearer secret", "omit", false]);
  expect([own?.headers.get("Authorization"), own?.credentials]).toEqual([null, "same-origin"]);
});

it("says so where nothing answers", async () => {
  fetched.mockRejectedValue(new TypeError("Failed to fetch"));
  await expect(make()).rejects.toMatchObject({ code: "unreachable" });
});

it("comes back from signing in to where one was", () => {
  expect(signInAddress("/missions/1?tab=topics&x=a b")).toBe("/sign-in?return_to=%2Fmissions%2F1%3Ftab%3Dtopics%26x%3Da+b");
});

test("a change names the etag that was looked at", () => {
  expect(ifMatch("a0")).toEqual({ "If-Match": '"a0"' });
  expect(ifMatch(undefined)).toEqual({});
});

test("what this page made of it counts as looked at, and going back ends nowhere", () => {
  noteNewEtag("b0", "b1");
  noteNewEtag("b1", "b2");
  expect(ifMatch("b0")).toEqual({ "If-Match": '"b2"' });
  noteNewEtag("b2", "b0");
  expect(ifMatch("b1")).toEqual({ "If-Match": '"b0"' });
  expect(ifMatch("b0")).toEqual({ "If-Match": '"b0"' });
});
