import { expect, it } from "vitest";
import { isOn, standingOf } from "./scrub";

const [began, ended] = ["2026-05-01T00:00:00Z", "2026-05-01T00:01:00Z"];

it("tells how a scrub stands", () => {
  expect(standingOf({ started_at: null, ended_at: null, stopped: null })).toBe("waits");
  expect(standingOf({ started_at: began, ended_at: null, stopped: null })).toBe("on");
  expect(standingOf({ started_at: began, ended_at: ended, stopped: null })).toBe("done");
  expect(standingOf({ started_at: began, ended_at: ended, stopped: "It looks like another store." })).toBe("stopped");
});

it("knows of one that another would only repeat", () => {
  expect([null, { ended_at: null }, { ended_at: ended }].map(isOn)).toEqual([false, true, false]);
});
