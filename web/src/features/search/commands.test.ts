import { expect, it } from "vitest";
import { downloadScript, markedAt, searchCommands, withTerm } from "./queries";

it("quotes what a shell would read otherwise", () => {
  expect(searchCommands("alps topic:/imu/*").cli).toBe("klein search 'alps topic:/imu/*'");
  expect(searchCommands("").cli).toBe("klein search ''");
  expect(searchCommands("-label:draft").cli).toBe("klein search -- -label:draft");
});

it("writes a script in which lines of a query stay within their quotes", () => {
  const script = downloadScript('"a\nrm -rf b"', "http://lab:8000", "Fetches.");
  expect(script).toContain("--query '\"a\nrm -rf b\"' --dest");
  expect(script).toContain('KLEINKRAM_URL="${KLEINKRAM_URL:-http://lab:8000}"');
});

it("adds terms as the server reads them", () => {
  expect(withTerm("alps", "topic", "/imu")).toBe("alps topic:/imu");
  expect(withTerm("", "topic", 'a "b"')).toBe('topic:"a \\"b\\""');
});

it("finds the place of what is wrong by characters", () => {
  expect(markedAt("🤖 size:big x", 3, "size:big")).toEqual({ before: "🤖 ", wrong: "size:big", after: " x" });
  expect(markedAt('a "open', 3, '"open')).toEqual({ before: "a ", wrong: '"open', after: "" });
});
