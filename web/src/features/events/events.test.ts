// Events: what a form changes, who may change them, commands, terms of searches, and marks on a time axis.
import { describe, expect, it } from "vitest";
import { changesOf, cutAllCommand, cutCommand, cutPage, draftOf, eventTermsOf, labelsOf, mayChange, newEvent, timesOf, type FindingWithTime, type MissionEvent } from "./events";
import { gapsOf, markAt, marksOf, neighbour, openFindings, pathsOf } from "./marks";

const S = 1e9;
const ORIGIN = 1_747_035_000 * S;
const MISSION = { id: "m", name: "day", project: { id: "p", name: "Alps" } };

function event(more: Partial<MissionEvent> = {}): MissionEvent {
  return {
    id: "e", mission: MISSION, name: "stumble", start_ns: ORIGIN + 10 * S, end_ns: null, labels: [], colour: null, note: "", refers_to: "mission", file: null, recording: null, topic: null,
    run_id: null, finding_id: null, created_at: "", created_by: { id: "ada", name: "Ada" }, etag: "1", ...more,
  };
}

function finding(id: number, severity: "info" | "warning" | "error", seconds: number): FindingWithTime {
  return { id, run_id: "r", mission: MISSION, action: { id: "a", name: "look" }, parameters: {}, ended_at: null, finding: { severity, code: "imu.gap", message: "A gap", time_ns: ORIGIN + seconds * S } } as unknown as FindingWithTime;
}

describe("a form", () => {
  const times = { startNs: ORIGIN + 10 * S, endNs: ORIGIN + 12.5 * S };
  const old = event({ end_ns: times.endNs, labels: ["left", "slow"], colour: "#d62728" });
  const before = draftOf(old, times, ORIGIN);

  it("counts seconds from the start of the mission", () => {
    expect(before).toMatchObject({ startSeconds: "10", durationSeconds: "2.5", labels: "left, slow", colour: "#d62728" });
    expect(draftOf(old, { ...times, endNs: null }, ORIGIN).durationSeconds).toBe("");
  });

  it("sends what was edited, and no time that was not", () => {
    expect(timesOf(before, before, times, ORIGIN)).toEqual(times);
    expect(changesOf(before, before, times, times)).toEqual({});
    const named = { ...before, name: " slip ", labels: "slow ,left,slow", colour: "" };
    expect(changesOf(named, before, times, times)).toEqual({ name: "slip", labels: ["slow", "left"], colour: null });
  });

  it("keeps the duration of a span that is moved, and the start of one that is resized", () => {
    expect(timesOf({ ...before, startSeconds: "20" }, before, times, ORIGIN)).toEqual({ startNs: ORIGIN + 20 * S, endNs: ORIGIN + 22.5 * S });
    expect(timesOf({ ...before, durationSeconds: "4" }, before, times, ORIGIN)).toEqual({ startNs: times.startNs, endNs: times.startNs + 4 * S });
    expect(timesOf({ ...before, durationSeconds: "" }, before, times, ORIGIN)).toEqual({ startNs: times.startNs, endNs: null });
  });

  it("refuses what is no time", () => {
    for (const edit of [{ startSeconds: "" }, { startSeconds: "soon" }, { durationSeconds: "-1" }, { startSeconds: "-1e12" }]) {
      expect(timesOf({ ...before, ...edit }, before, times, ORIGIN)).toBeNull();
    }
  });

  it("adds a finding once, by its id", () => {
    expect(newEvent(before, times, { finding_id: 7, topic: "/imu" })).toMatchObject({ name: "stumble", start_ns: times.startNs, end_ns: times.endNs, finding_id: 7, topic: "/imu" });
    expect(labelsOf(" , a,b , a")).toEqual(["a", "b"]);
  });
});

it("lets people change their own events with CREATE, and those of others with WRITE and DELETE", () => {
  expect(mayChange(event(), "ada", "CREATE")).toEqual({ edit: true, remove: true });
  expect(mayChange(event(), "ben", "CREATE")).toEqual({ edit: false, remove: false });
  expect(mayChange(event(), "ben", "WRITE")).toEqual({ edit: true, remove: false });
  expect(mayChange(event(), "ben", "DELETE")).toEqual({ edit: true, remove: true });
  expect(mayChange(event(), "ada", "READ")).toEqual({ edit: false, remove: false });
  expect(mayChange(event({ created_by: null }), undefined, undefined)).toEqual({ edit: false, remove: false });
});

describe("cutting", () => {
  it("takes 5 s around an event", () => {
    expect(cutCommand(event({ name: "trot / left" }))).toBe(`klein cut -p Alps -m day --start ${ORIGIN + 5 * S} --end ${ORIGIN + 15 * S} -o trot_left.mcap`);
    expect(cutCommand(event({ name: "転倒" }))).toContain("-o _.mcap");
    expect(cutAllCommand(MISSION, "a*[1]")).toBe("klein cut --event 'a[*][[]1]' --around 5s -p Alps -m day -o events");
    expect(cutAllCommand(MISSION, null)).toContain("--event '*' ");
  });

  it("in the browser needs one recording that has the event", () => {
    const files = [
      { id: "a", path: "a.mcap", start_ns: ORIGIN, end_ns: ORIGIN + 60 * S },
      { id: "b", path: "b.mcap", start_ns: ORIGIN + 100 * S, end_ns: ORIGIN + 160 * S },
      { id: "c", path: "c.db3", start_ns: ORIGIN + 200 * S, end_ns: ORIGIN + 260 * S },
    ];
    expect(cutPage(event(), files)).toEqual({ name: "file", params: { fileId: "a" }, query: { slice: `${ORIGIN + 5 * S}-${ORIGIN + 15 * S}` } });
    expect(cutPage(event({ start_ns: ORIGIN + 58 * S, end_ns: ORIGIN + 100 * S }), files)).toBeNull();
    expect(cutPage(event({ start_ns: ORIGIN + 210 * S }), files)).toBeNull();
    expect(cutPage(event({ start_ns: ORIGIN + 210 * S, refers_to: "file", file: { id: "b", path: "b.mcap" } }), files)).toMatchObject({ params: { fileId: "b" } });
    expect(cutPage(event({ refers_to: "file" }), files)).toBeNull();
    expect(cutPage(event({ refers_to: "recording" }), files)).toBeNull();
  });
});

it("reads the terms of events in a search", () => {
  expect(eventTermsOf('alps event:stumble -event:slip event:"a \\"b\\" c" label:event:x event:')).toEqual(["stumble", 'a "b" c']);
  expect(eventTermsOf("topic:/event")).toEqual([]);
});

describe("marks", () => {
  const axis = { startNs: ORIGIN, endNs: ORIGIN + 100 * S };
  const events = [event({ start_ns: ORIGIN + 50 * S, end_ns: ORIGIN + 60 * S, finding_id: 2 }), event({ start_ns: ORIGIN + 55 * S, name: "inside", colour: "#2b8a3e" })];
  const findings = [finding(1, "error", 20), finding(2, "warning", 50), finding(3, "info", 200)];
  const marks = marksOf(events, findings);

  it("are events and the findings that did not become one, by time", () => {
    expect(marks.map(({ kind, startNs }) => `${kind} ${(startNs - ORIGIN) / S}`)).toEqual(["error 20", "event 50", "event 55", "info 200"]);
    expect(openFindings(events, findings).map(({ id }) => id)).toEqual([1, 3]);
  });

  it("are drawn once for each kind and colour, within the axis", () => {
    const paths = pathsOf(marks, axis, 1000);
    expect(paths.map(({ kind, colour }) => `${kind} ${colour}`)).toEqual(["error null", "event null", "event #2b8a3e"]);
    expect(paths[1]?.path).toBe("M500.0 1H600.0V9H500.0Z");
    expect(pathsOf([{ kind: "event", label: "", colour: null, startNs: ORIGIN - S, endNs: ORIGIN + 200 * S }], axis, 1000)[0]?.path).toBe("M0.0 1H1000.0V9H0.0Z");
  });

  it("are found where the pointer is, the shortest first", () => {
    const at = (xPx: number, yPx: number) => markAt(marks, axis, 1000, { xPx, yPx }, 6)?.label ?? null;
    expect([at(520, 3), at(552, 3), at(203, 15), at(203, 3), at(300, 3)]).toEqual(["stumble", "inside", "A gap", "A gap", null]);
  });

  it("are walked by keys", () => {
    expect(neighbour(marks, "next", ORIGIN + 20 * S + 256, 1000)?.startNs).toBe(ORIGIN + 50 * S);
    expect(neighbour(marks, "previous", ORIGIN + 50 * S + 256, 1000)?.startNs).toBe(ORIGIN + 20 * S);
    expect(neighbour(marks, "previous", ORIGIN, 1000)).toBeUndefined();
  });

  it("show gaps between what was recorded", () => {
    expect(gapsOf([{ fromNs: 0n, toNs: 10n }, { fromNs: 30n, toNs: 40n }])).toEqual([{ startNs: 10, endNs: 30 }]);
  });
});
