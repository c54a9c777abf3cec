import { describe, expect, it } from "vitest";
import { LogLines, shownLine } from "./log";
import { areaOf, levels, most, rates, rowsOf, scaleOf, trackOf } from "./preview";
import { chipOf, failedChecksOf, findingsOf, metricNames, metricText, placeOf, placementFacts, waitOf } from "./states";
import type { Run } from "@/api/types";

describe("lines of a log", () => {
  it("are the same however they came", () => {
    const log = new LogLines();
    for (const piece of ["one\ntw", "o\n", "\nfour", "", " and more"]) log.append(piece);
    expect(Array.from({ length: log.end }, (_, at) => log.line(at))).toEqual(["one", "two", "", "four and more"]);
    log.append("\n");
    expect([log.end, log.line(3), log.line(4)]).toEqual([4, "four and more", ""]);
  });
  it("keep their numbers when the earliest are let go", () => {
    const log = new LogLines(3);
    for (let at = 0; at < 10; at += 1) log.append(`line ${at}\n`);
    expect([log.first, log.end, log.line(0), log.line(9)]).toEqual([7, 10, "", "line 9"]);
  });
  it("are found piece by piece, whatever their case, each once", () => {
    const log = new LogLines();
    log.append("an Error, error\nfine\n");
    log.append("fine\nERROR\n");
    const first = log.find("error", 0);
    expect(first).toEqual({ matches: [0], upTo: 2 });
    expect(log.find("error", first.upTo)).toEqual({ matches: [3], upTo: 4 });
    expect(log.find("error", 4)).toEqual({ matches: [], upTo: 4 });
  });
});

describe("a line as it is shown", () => {
  it("is what a terminal would leave of it", () => {
    expect(shownLine("10 %\r50 %\r100 %\r", "…")).toBe("100 %");
    expect(shownLine("\u001b[31mred\u001b[0m \u0007bell", "…")).toBe("red bell");
  });
  it("is cut where nobody reads on", () => {
    expect(shownLine("x".repeat(5000), "…")).toHaveLength(2001);
  });
});

const usage = (cpu: number, memory: number) => ({ cpu_s: cpu, memory_bytes: memory, peak_memory_bytes: memory, read_bytes: 0, written_bytes: 0 });
const samples = [{ at_s: 1, usage: usage(0, 10) }, { at_s: 3, usage: usage(4, 30) }, { at_s: 3, usage: usage(4, 30) }, { at_s: 5, usage: usage(5, 20) }];

it("a rate is what a sum grew by, over the time that took", () => {
  expect(rates(samples, "cpu_s")).toEqual({ at: [3, 5], values: [2, 0.5] });
});

it("an area hasRight from the first moment to the last, and as high as the most", () => {
  expect(most(levels(samples, "memory_bytes"))).toBe(30);
  expect(areaOf({ at: [1, 3, 5], values: [1, 2, 0] })).toBe("M0 1L0.00 0.5000L50.00 0.0000L100.00 1.0000L100 1Z");
  expect(areaOf({ at: [], values: [] })).toBe("");
});

describe("a table", () => {
  it("is read as spreadsheets write it", () => {
    expect(rowsOf('\ufeffa,"b ""c"", d"\r\n1,\n"two\nlines",3', 10)).toEqual({ rows: [["a", 'b "c", d'], ["1", ""], ["two\nlines", "3"]], count: 3 });
  });
  it("is counted whole, and shown in part", () => {
    expect(rowsOf("a\n1\n2\n3\n", 2)).toEqual({ rows: [["a"], ["1"]], count: 4 });
  });
  it("ends also where a quote does not", () => {
    expect(rowsOf('a,"b', 5)).toEqual({ rows: [["a", "b"]], count: 1 });
  });
});

describe("a track", () => {
  it("is in metres, with north up", () => {
    const track = trackOf({ type: "Feature", geometry: { type: "LineString", coordinates: [[8, 0], [8.001, 0], [8.001, 0.001]] } });
    expect(track?.points).toBe(3);
    expect(track?.lines[0]?.map(([x, y]) => [Math.round(x), Math.round(y) + 0])).toEqual([[0, 0], [111, 0], [111, -111]]);
  });
  it("is made of lone points too", () => {
    const point = (longitude: number) => ({ type: "Feature", geometry: { type: "Point", coordinates: [longitude, 47] } });
    expect(trackOf({ type: "FeatureCollection", features: [point(8), point(9)] })?.lines).toHaveLength(1);
  });
  it("is nothing where there are no places", () => {
    for (const none of [null, 3, "text", [], { type: "LineString", coordinates: [["8", "47"], [900, 900]] }]) expect(trackOf(none)).toBeNull();
  });
  it("has a scale of a round length", () => {
    expect([scaleOf(100), scaleOf(260), scaleOf(3)]).toEqual([20, 50, 0.5]);
  });
});

function run(metrics: Run["metrics"], counts: Run["finding_counts"] = {}): Run {
  return { metrics, finding_counts: counts } as unknown as Run;
}

it("a run is green only where it found nothing wrong, and its result does not hide that it failed", () => {
  const chip = (more: Partial<Run>) => {
    const { label, tone } = chipOf({ ...run([]), message: "", ...more });
    return `${label} ${tone}`;
  };
  expect(chip({ state: "done", verdict: null })).toBe("Done good");
  expect(chip({ state: "done", verdict: "good" })).toBe("Done good");
  expect(chip({ state: "done", verdict: "warnings" })).toBe("Done: warnings attention");
  expect(chip({ state: "done", verdict: "bad" })).toBe("Done: bad bad");
  expect(chip({ state: "failed", verdict: null })).toBe("Failed bad");
  expect(chip({ state: "running", verdict: null })).toBe("Running accent");
});

it("counts checks that failed or could not be made, not those that passed", () => {
  const labels = (counts: Run["check_counts"]) => failedChecksOf({ ...run([]), check_counts: counts }).map(({ label }) => label);
  expect(labels({ ok: 12, needs_content: 2 })).toEqual([]);
  expect(labels({ not_made: 1, warning: 2, error: 1, ok: 3 })).toEqual(["1 check failed", "2 check warnings", "1 check not made"]);
});

it("counts findings by severity, the worst first", () => {
  expect(findingsOf(run([], { info: 3, error: 1, warning: 2 })).map(({ label }) => label)).toEqual(["1 error", "2 warnings", "3 infos"]);
  expect(findingsOf(run([]))).toEqual([]);
});

it("writes large numbers without rounding their digits away", () => {
  const text = (value: number) => metricText(run([{ name: "n", value, unit: null, file: null, labels: {} }]), "n");
  expect([text(123_456), text(123_456.789), text(-1_234_567), text(9_999.94), text(0.000123456)]).toEqual(["123,456", "123,457", "-1,234,567", "9,999.9", "0.00012346"]);
});

it("names the metrics that most runs have first, and writes them with their unit", () => {
  const one = run([{ name: "ate_rmse", value: 0.1234567, unit: "m", file: null, labels: {} }, { name: "hz", value: 20, unit: null, file: "a.bag", labels: {} }]);
  const two = run([{ name: "ate_rmse", value: 1, unit: null, file: null, labels: {} }, { name: "of_files", value: 1, file: "a", labels: {} }, { name: "of_files", value: 2, file: "b", labels: {} }]);
  expect(metricNames([two, one])).toEqual(["ate_rmse", "hz", "of_files"]);
  expect([metricText(one, "ate_rmse"), metricText(one, "hz"), metricText(two, "of_files"), metricText(two, "hz")]).toEqual(["0.12346 m", "20", "2 values", ""]);
});

describe("the place of a run on a cluster", () => {
  const placement = { job_id: "4711_3", node: "gpu07", queued_s: 12.4, gpus: ["GPU-5f2e", "GPU-9a10"], cpu_s: 41.25, peak_memory_bytes: 1_500_000_000, requeues: 1 };
  it("is its node and its job, as far as they are known", () => {
    expect(placeOf({ placement })).toBe("gpu07, job 4711_3");
    expect(placeOf({ placement: { ...placement, node: null } })).toBe("job 4711_3");
    expect(placeOf({ placement: null })).toBe("");
  });
  it("has facts only where the runner reported them", () => {
    expect(placementFacts({ placement }).map(({ label, value }) => `${label}: ${value}`)).toEqual([
      "Job: 4711_3", "Queue wait: 12 s", "Requeued: 1 time", "GPUs: GPU-5f2e, GPU-9a10", "Accounted: 41.3 s of cores, 1.5 GB of memory at most",
    ]);
    expect(placementFacts({ placement: { gpus: [], requeues: 0 } })).toEqual([]);
    expect(placementFacts({ placement: null })).toEqual([]);
  });
  it("has a reason while its job waits, which is not that of a queued run", () => {
    const progress = { fraction: 0, message: "waits in the queue of Slurm: Resources" };
    expect(waitOf({ state: "preparing", waits_for: null, progress })).toBe("Waits in the queue of Slurm: Resources");
    expect(waitOf({ state: "running", waits_for: null, progress })).toBe("");
    expect(waitOf({ state: "queued", waits_for: "No runner is registered.", progress: null })).toBe("No runner is registered.");
  });
});
