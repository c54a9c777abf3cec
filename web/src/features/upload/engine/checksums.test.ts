// @vitest-environment node
import { describe, expect, it } from "vitest";
import { Hashing, newChecksum } from "./checksums";
import { RateMeter } from "./progressStore";
import { MIN_PART_BYTES, partSizeBytes } from "./types";
import { etagOf, meaningOf } from "./store";

const CHECK = new TextEncoder().encode("123456789");

describe("checksums", () => {
  // Source: the check values of the CRC catalogue (CRC-64/NVME), FIPS 180-4 and RFC 1321; the Python client has the same.
  it.each([
    ["crc64nvme", "ae8b14860a799888"],
    ["sha256", "15e2b0d3c33891ebb0f1ef609ec419420c20e320ce94c65fbc8c3312448eb225"],
    ["md5", "25f9e794323b453885f5181f1b624d0b"],
  ] as const)("of %s are the known ones", async (kind, known) => {
    expect((await newChecksum(kind)).init().update(CHECK).digest("hex")).toBe(known);
  });

  it("keep their leading zeros", async () => {
    expect((await newChecksum("crc64nvme")).init().digest("hex")).toBe("0000000000000000");
  });

  it("of a whole file and of its parts are made side by side, file after file", async () => {
    const hashing = await Hashing.ready();
    for (let time = 0; time < 2; time++) {
      hashing.beginWhole();
      hashing.addToWhole(CHECK.subarray(0, 4));
      expect((await hashing.beginPart("crc64nvme")).update(CHECK).digest("hex")).toBe("ae8b14860a799888");
      hashing.addToWhole(CHECK.subarray(4));
      expect(hashing.endWhole().crc64nvme).toBe("ae8b14860a799888");
    }
  });
});

describe("parts", () => {
  it.each([[0, 1], [1, 1], [40 * 1024 ** 3, 1], [40 * 1024 ** 3 + 1, 2], [5 * 1024 ** 4, 128]])("of %d bytes have %d times 5 MiB", (size, steps) => {
    expect(partSizeBytes(size)).toBe(steps * MIN_PART_BYTES);
  });
});

describe("what a store's answer means", () => {
  it.each([
    [404, "NoSuchUpload", "gone"], [404, "", "try_again"], [403, "", "sign_again"], [503, "SlowDown", "try_again"],
    [400, "RequestTimeout", "try_again"], [400, "BadDigest", "refused"], [0, "", "try_again"],
  ])("%d %s: %s", (status, code, meaning) => {
    expect(meaningOf(status, code)).toBe(meaning);
  });

  it("has an etag without its quotes, or none", () => {
    expect([etagOf('"abc"'), etagOf(null)]).toEqual(["abc", ""]);
  });
});

describe("a meter", () => {
  it("says nothing before anything moved, then the rate of the last seconds", () => {
    const meter = new RateMeter();
    expect(meter.at(0, 100)).toEqual({ bytesPerS: null, leftS: null });
    meter.moved(1000);
    expect(meter.at(60_000, 9000).bytesPerS).toBeNull();
    meter.moved(2000);
    expect(meter.at(62_000, 7000)).toEqual({ bytesPerS: 1000, leftS: 7 });
    expect(meter.at(90_000, 7000)).toEqual({ bytesPerS: 0, leftS: null });
    meter.restart();
    expect(meter.at(90_500, 7000).bytesPerS).toBeNull();
  });
});
