import { describe, expect, it } from "vitest";
import { Problem, problemInstead, problemOf, toProblem } from "./problem";
import { texts } from "@/texts/problem";

function answer(status: number): Response {
  return new Response(null, { status, headers: { "X-Request-Id": "abc" } });
}

describe("what the server tells", () => {
  const body = {
    type: "about:blank", title: "Metadata invalid", status: 422, detail: "It lacks a robot.", code: "metadata_invalid",
    request_id: "from-the-document", problems: [{ field: "robot", message: "is required" }, "nonsense"],
  };
  it("is its own sentence, what to do, and the id", () => {
    const problem = problemOf(body, answer(422));
    expect(problem.message).toBe("It lacks a robot.");
    expect(problem.remedy).toBe(texts.remedies.metadata_invalid);
    expect(problem.requestId).toBe("from-the-document");
    expect(problem.fields).toEqual([{ field: "robot", message: "is required" }]);
    expect(problem.isPassing).toBe(false);
  });
});

describe("what is no answer of ours", () => {
  it("is a server that cannot be reached, where a proxy says so", () => {
    expect(problemOf("<html>", answer(502))).toMatchObject({ code: "unreachable", isPassing: true, requestId: "abc" });
  });
  it("is said with its status", () => {
    expect(problemOf("<html>", answer(418)).message).toContain("418");
  });
  it("is a network that fails", () => {
    expect(toProblem(new TypeError("Failed to fetch"))).toMatchObject({ code: "unreachable", isPassing: true });
  });
  it("is a fault of the app's", () => {
    expect(toProblem(new RangeError("bad"))).toMatchObject({ code: "unexpected", message: "bad" });
    const known = new Problem("forbidden", 403, "No", "You may not.");
    expect(toProblem(known)).toBe(known);
  });
});

describe("what stands in a page's place", () => {
  const away = new Problem("unreachable", 0, "", "nobody answers");
  it("is nothing while there is something to show and the server may come back", () => {
    expect(problemInstead(null, undefined)).toBeNull();
    expect(problemInstead(away, { name: "day" })).toBeNull();
    expect(problemInstead(away, undefined)).toBe(away);
  });
  it("is what the server has decided, whatever was shown before", () => {
    const gone = new Problem("not_found", 404, "", "there is none");
    expect(problemInstead(gone, { name: "day" })).toBe(gone);
  });
});
