import { expect, it } from "vitest";
import { PreviewFile } from "./preview_file";
import type { ByteSource } from "./ranges";
import example from "./testing/preview.json";

const BYTES = Uint8Array.from(atob(example.base64), (letter) => letter.charCodeAt(0));
const START_NS = 1_700_000_000_000_000_000n;

function sourceOf(bytes: Uint8Array, reads: number[] = []): ByteSource {
  return {
    sizeBytes: bytes.length,
    read: (offset, length) => {
      reads.push(length);
      return offset + length > bytes.length ? Promise.reject(new RangeError("outside of the file")) : Promise.resolve(bytes.slice(offset, offset + length));
    },
  };
}

it("reads the fields of a topic that are asked for, and only their sections", async () => {
  const reads: number[] = [];
  const preview = await PreviewFile.open(sourceOf(BYTES, reads));
  const afterIndex = reads.length;
  expect(preview.fieldsOf("/imu")).toContain("angular.x");
  expect(preview.fieldsOf("/other")).toEqual([]);
  expect(reads.length).toBe(afterIndex);
  const series = await preview.series("/imu", ["angular.x", "covariance[0]", "other"]);
  expect(series?.messagesPerBin).toBe(10);
  expect([...(series?.firstNs ?? [])]).toEqual([0n, 1n, 2n, 3n].map((second) => START_NS + second * 1_000_000_000n));
  expect(series?.lastNs[3]).toBe(START_NS + 3_900_000_000n);
  expect(Array.from(series?.fields[0]?.low ?? [])).toEqual([-1, 0.1, NaN, 3]);
  expect(Array.from(series?.fields[0]?.high ?? [])).toEqual([1, 0.2, NaN, 3]);
  expect(Array.from(series?.fields[1]?.low ?? [])).toEqual([0.5, 0.5, 0.5, 0.5]);
  expect(series?.fields[2]).toBeNull();
  expect([...(series?.readSpans ?? [])].map((timeNs) => timeNs - START_NS)).toEqual([0n, 1_900_000_000n, 2_000_000_000n, 3_900_000_000n]);
  expect(reads.length - afterIndex).toBe(5); // two of times, two of numbers, one of the parts that were read
  expect(await preview.series("/none", [])).toBeNull();
});

it("reads the pictures of a camera", async () => {
  const preview = await PreviewFile.open(sourceOf(BYTES));
  expect(preview.cameras).toEqual(["/camera"]);
  const camera = await preview.camera("/camera");
  expect(camera?.thumbnails.map(({ timeNs, width, height }) => [timeNs, width, height])).toEqual([[START_NS, 4, 3], [START_NS + 1n, 4, 3]]);
  expect(await Promise.all((camera?.thumbnails ?? []).map(({ jpeg }) => jpeg.text()))).toEqual(["first", "second"]);
  expect(await preview.camera("/none")).toBeNull();
});

it("reads the track of a topic with fixes, not that of poses", async () => {
  const preview = await PreviewFile.open(sourceOf(BYTES));
  const track = await preview.track("/gnss");
  expect([...(track?.timesNs ?? [])]).toEqual([START_NS, START_NS + 2n]);
  expect(Array.from(track?.positions ?? [])).toEqual([47.1, 8.123456789, NaN, 47.2, 8.2, 430.5]);
  expect(await preview.track("/odometry")).toBeNull();
  expect(await preview.track("/none")).toBeNull();
});

it("reads the clouds of a topic one by one", async () => {
  const reads: number[] = [];
  const preview = await PreviewFile.open(sourceOf(BYTES, reads));
  const afterIndex = reads.length;
  expect(preview.cloudTimes("/lidar")).toEqual([START_NS, START_NS + 2n]);
  expect(preview.cloudTimes("/none")).toEqual([]);
  expect(reads.length).toBe(afterIndex);
  expect(await preview.cloud("/lidar", START_NS)).toEqual({ timeNs: START_NS, frame: "lidar", totalPoints: 100_000, xyz: Float32Array.of(1, 2, 3, -1.5, 0, 0.25) });
  expect(reads.length - afterIndex).toBe(1);
  expect((await preview.cloud("/radar", START_NS + 1n))?.xyz.length).toBe(0);
  expect(await preview.cloud("/lidar", START_NS + 1n)).toBeNull();
});

it("reads the lines of a topic", async () => {
  const preview = await PreviewFile.open(sourceOf(BYTES));
  expect(await preview.lines("/rosout")).toEqual([
    { timeNs: START_NS, severity: "info", source: "driver", text: "started" },
    { timeNs: START_NS + 5n, severity: "error", source: "driver", text: "über limit" },
  ]);
  expect(await preview.lines("/none")).toEqual([]);
});

it("refuses what is no preview, and any damage of its index, by name", async () => {
  const isDamaged: unknown = expect.objectContaining({ code: "index_damaged" });
  await expect(PreviewFile.open(sourceOf(BYTES.slice(0, 10)))).rejects.toEqual(isDamaged);
  await expect(PreviewFile.open(sourceOf(new Uint8Array(100)))).rejects.toEqual(isDamaged);
  for (const place of [17, 30, 100]) {
    const bytes = BYTES.slice();
    bytes[place] = (bytes[place] ?? 0) ^ 0xff;
    await expect(PreviewFile.open(sourceOf(bytes))).rejects.toEqual(isDamaged);
  }
  const announced = BYTES.slice();
  new DataView(announced.buffer).setUint32(12, 2 ** 31, true); // an index that would fill the memory
  await expect(PreviewFile.open(sourceOf(announced))).rejects.toEqual(isDamaged);
});

it("refuses sections that are damaged, by name", async () => {
  const bytes = BYTES.slice();
  const stored = new DataView(bytes.buffer).getUint32(8, true);
  bytes.fill(0xff, 16 + stored);
  const preview = await PreviewFile.open(sourceOf(bytes));
  await expect(preview.series("/imu", ["angular.x"])).rejects.toMatchObject({ code: "index_damaged" });
});
