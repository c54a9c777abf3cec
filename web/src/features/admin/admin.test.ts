import { expect, it } from "vitest";
import { isUnfinished, matching, scrubStateOf, valueOf, type Setting } from "./queries";

const [began, ended] = ["2026-05-01T00:00:00Z", "2026-05-01T00:01:00Z"];

it("returns the state of a scrub", () => {
  expect(scrubStateOf({ started_at: null, ended_at: null, aborted_reason: null })).toBe("queued");
  expect(scrubStateOf({ started_at: began, ended_at: null, aborted_reason: null })).toBe("running");
  expect(scrubStateOf({ started_at: began, ended_at: ended, aborted_reason: null })).toBe("done");
  expect(scrubStateOf({ started_at: began, ended_at: ended, aborted_reason: "It looks like another store." })).toBe("stopped");
});

it("an unfinished scrub is one that has not ended", () => {
  expect([null, { ended_at: null }, { ended_at: ended }].map(isUnfinished)).toEqual([false, true, false]);
});

const setting = (name: string, value: unknown, more: Partial<Setting> = {}): Setting => ({ name, value, is_set: false, is_secret: false, ...more });

it("shows no secret, only whether there is one", () => {
  expect(valueOf(setting("s3_secret_key", "never sent", { is_secret: true, is_set: true }))).toBe("set (hidden)");
  expect(valueOf(setting("s3_secret_key", null, { is_secret: true }))).toBe("not set");
});

it("shows values as they would be written", () => {
  expect(["x", 30, false, null, [], [1]].map((value) => valueOf(setting("a", value)))).toEqual(["x", "30", "false", "none", "none", "[1]"]);
});

it("finds settings by the words of their names", () => {
  const all = [setting("KLEINKRAM_TRASH_DAYS", 30, { is_set: true }), setting("KLEINKRAM_LAB_NAME", "x")];
  expect(matching(all, "trash days", false)).toEqual([all[0]]);
  expect(matching(all, "", true)).toEqual([all[0]]);
  expect(matching(all, "lab_name", true)).toEqual([]);
});
