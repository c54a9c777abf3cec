import { expect, it } from "vitest";
import { byKind, severityOf, spreadOf, titleOf, type Warning } from "./warnings";

function warning(code: string, where = "", source = "a.mcap"): Warning {
  return { code, message: `${code} at ${where}`, where, source, fileId: null };
}

it("sums up each kind, the most severe and most frequent first", () => {
  const gaps = ["/imu", "/imu", "/odom"].map((topic) => warning("long-gap", topic));
  const kinds = byKind([warning("silent-topic", "/gps"), ...gaps, warning("starts-late", "/tf"), warning("damaged", "byte 7"), warning("long-gap", "/imu", "b.mcap")]);
  expect(kinds.map(({ code, severity, warnings }) => `${severity} ${warnings.length} ${code}`)).toEqual([
    "error 1 damaged", "warning 4 long-gap", "warning 1 starts-late", "info 1 silent-topic",
  ]);
  expect(kinds.map(spreadOf)).toEqual(["", "on 2 topics, in 2 files", "on 1 topic", "on 1 topic"]);
});

it("takes a code that it does not know for a warning, and writes it as words", () => {
  expect([severityOf("something-new"), titleOf("something-new")]).toEqual(["warning", "Something new"]);
});
