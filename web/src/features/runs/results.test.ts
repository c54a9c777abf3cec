import { expect, it } from "vitest";
import { findingsOf, metricNames, metricText } from "./results";
import type { Run } from "@/api/types";

function run(metrics: Run["metrics"], counts: Run["finding_counts"] = {}): Run {
  return { metrics, finding_counts: counts } as unknown as Run;
}

it("counts findings by severity, the worst first", () => {
  expect(findingsOf(run([], { info: 3, error: 1, warning: 2 })).map(({ label }) => label)).toEqual(["1 error", "2 warnings", "3 infos"]);
  expect(findingsOf(run([]))).toEqual([]);
});

it("writes large numbers without rounding their digits away", () => {
  const text = (value: number) => metricText(run([{ name: "n", value, unit: null, file: null }]), "n");
  expect([text(123_456), text(123_456.789), text(-1_234_567), text(9_999.94), text(0.000123456)]).toEqual(["123,456", "123,457", "-1,234,567", "9,999.9", "0.00012346"]);
});

it("names the metrics that most runs have first, and writes them with their unit", () => {
  const one = run([{ name: "ate_rmse", value: 0.1234567, unit: "m", file: null }, { name: "hz", value: 20, unit: null, file: "a.bag" }]);
  const two = run([{ name: "ate_rmse", value: 1, unit: null, file: null }, { name: "of_files", value: 1, file: "a" }, { name: "of_files", value: 2, file: "b" }]);
  expect(metricNames([two, one])).toEqual(["ate_rmse", "hz", "of_files"]);
  expect([metricText(one, "ate_rmse"), metricText(one, "hz"), metricText(two, "of_files"), metricText(two, "hz")]).toEqual(["0.12346 m", "20", "2 files", ""]);
});
