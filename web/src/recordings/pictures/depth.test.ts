import { deflateSync } from "node:zlib";
import { describe, expect, it } from "vitest";
import { compressedDepthOf, depthValues, rvlPixels } from "./compressed_depth";
import { greyPixels, isGreyPng } from "./grey_png";
import { pictureOf } from "./picture";
import { pixelsOf, type RawPicture } from "./pixels";
import { coloured, greys, pictureValues, type PictureValues } from "./values";

const [WIDTH, HEIGHT] = [7, 10];
/** With zeros at the beginning, in the middle and at the end, small and great steps. */
const DEPTH = Uint16Array.from({ length: WIDTH * HEIGHT }, (_, at) => (at < 3 || at % 11 < 2 || at > 66 ? 0 : (at * at * 977) % 65_536));

function values(encoding: string, width: number, data: Uint8Array, more: Partial<RawPicture> = {}): PictureValues {
  return pixelsOf({ width, height: 1, step: 0, encoding, isBigEndian: false, data, ...more }) as PictureValues;
}

/** RVL as its paper describes it: runs of zeros and others by turns, and what each of the others is more than the last. */
function rvl(pixels: Uint16Array, width: number, height: number): Uint8Array {
  const groups: number[] = [];
  const put = (number: number): void => {
    for (let rest = number; ; rest = Math.floor(rest / 8)) {
      const isLast = rest < 8;
      groups.push((rest % 8) + (isLast ? 0 : 8));
      if (isLast) return;
    }
  };
  let previous = 0;
  for (let at = 0; at < pixels.length; ) {
    const zeros = [...pixels.slice(at)].findIndex((pixel) => pixel !== 0);
    const run = zeros < 0 ? pixels.length - at : zeros;
    put(run);
    at += run;
    const others = [...pixels.slice(at)].findIndex((pixel) => pixel === 0);
    const count = others < 0 ? pixels.length - at : others;
    put(count);
    for (const pixel of pixels.slice(at, at + count)) {
      const step = pixel - previous;
      put(step >= 0 ? 2 * step : -2 * step - 1);
      previous = pixel;
    }
    at += count;
  }
  while (groups.length % 8 !== 0) groups.push(0);
  const words = new DataView(new ArrayBuffer(8 + groups.length / 2));
  words.setUint32(0, width, true);
  words.setUint32(4, height, true);
  for (let at = 0; at < groups.length; at += 8) {
    words.setUint32(8 + at / 2, Number.parseInt(groups.slice(at, at + 8).map((group) => group.toString(16)).join(""), 16), true);
  }
  return new Uint8Array(words.buffer);
}

/** A PNG whose rows have the filters 0 to 4 by turns. Checksums are left out: browsers do not get to see it. */
function png(pixels: Uint16Array, width: number, height: number): Uint8Array {
  const raw = (y: number, at: number): number => {
    if (y < 0 || at < 0) return 0;
    const pixel = pixels[y * width + (at >> 1)] ?? 0;
    return at % 2 === 0 ? pixel >> 8 : pixel & 255;
  };
  const rows = Array.from({ length: height }, (_, y) => {
    const filter = y % 5;
    const line = Array.from({ length: width * 2 }, (__, at) => {
      const [a, b, c] = [raw(y, at - 2), raw(y - 1, at), raw(y - 1, at - 2)];
      const nearest = [a, b, c].toSorted((one, other) => Math.abs(a + b - c - one) - Math.abs(a + b - c - other))[0] ?? 0;
      return (raw(y, at) - ([0, a, b, Math.floor((a + b) / 2), nearest][filter] ?? 0)) & 255;
    });
    return [filter, ...line];
  });
  const header = new DataView(new ArrayBuffer(13));
  header.setUint32(0, width);
  header.setUint32(4, height);
  header.setUint8(8, 16);
  const packed = deflateSync(Uint8Array.from(rows.flat()));
  const half = packed.length >> 1;
  return Uint8Array.from([
    0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10,
    ...chunk("IHDR", new Uint8Array(header.buffer)), ...chunk("tEXt", Uint8Array.of(1, 0, 2)), ...chunk("IDAT", packed.subarray(0, half)), ...chunk("IDAT", packed.subarray(half)), ...chunk("IEND", new Uint8Array()),
  ]);
}

function chunk(name: string, data: Uint8Array): number[] {
  const length = new DataView(new ArrayBuffer(4));
  length.setUint32(0, data.length);
  return [...new Uint8Array(length.buffer), ...new TextEncoder().encode(name), ...data, 0, 0, 0, 0];
}

function settings(a = 0, b = 0): number[] {
  const view = new DataView(new ArrayBuffer(12));
  view.setFloat32(4, a, true);
  view.setFloat32(8, b, true);
  return [...new Uint8Array(view.buffer)];
}

describe("pictures of values", () => {
  it("have the numbers of both byte orders, and their unit", () => {
    const depth = values("16UC1", 4, Uint8Array.of(0, 0, 0xe8, 3, 0xd0, 7, 0xb8, 0x0b));
    expect([[...depth.values], depth.range, depth.unit]).toEqual([[0, 1000, 2000, 3000], [1000, 3000], "mm"]);
    expect([...values("mono16", 2, Uint8Array.of(3, 0xe8, 0x0b, 0xb8), { isBigEndian: true }).values]).toEqual([1000, 3000]);
    const metres = values("32FC1", 4, new Uint8Array(Float32Array.of(Number.NaN, 0.5, 2.5, Infinity).buffer));
    expect([metres.range, metres.unit]).toEqual([[0.5, 2.5], "m"]);
    expect(values("16SC1", 2, Uint8Array.of(0xff, 0xff, 1, 0)).range).toEqual([-1, 1]);
    expect(values("16UC1", 1, Uint8Array.of(0, 0)).range).toBeNull();
  });

  it("skip what fills up a row", () => {
    expect([...values("16UC1", 1, Uint8Array.of(1, 0, 9, 9, 2, 0), { height: 2, step: 4 }).values]).toEqual([1, 2]);
  });

  it("leave single wrong measurements out of the range", () => {
    const most = Float32Array.from({ length: 1000 }, (_, at) => 1 + at / 1000);
    most.set([0.001, 900, Number.NaN, 0], 500);
    const { range } = pictureValues(1000, 1, most, "m");
    expect(range?.[0]).toBeCloseTo(1.01, 1);
    expect(range?.[1]).toBeCloseTo(1.99, 1);
    const large = Float32Array.from({ length: 1_000_000 }, (_, at) => at + 1);
    expect(pictureValues(1000, 1000, large, null).range?.map((value) => Math.round(value / 10_000))).toEqual([1, 99]);
  });

  it("get the colours of their range, and none where nothing was measured", () => {
    const rgba = coloured({ values: Float32Array.of(0, Number.NaN, 1, 2, 3, 9, -5, Infinity) }, [1, 3], greys());
    const pixels = Array.from({ length: 8 }, (_, at) => [...rgba.slice(4 * at, 4 * at + 4)]);
    const grey = (level: number): number[] => [level, level, level, 255];
    expect(pixels).toEqual([[0, 0, 0, 0], [0, 0, 0, 0], grey(0), grey(128), grey(255), grey(255), grey(0), [0, 0, 0, 0]]);
    expect([...coloured({ values: Float32Array.of(5, 4) }, [4, 4], greys())]).toEqual([...grey(255), ...grey(0)]);
  });
});

describe("compressedDepth", () => {
  it("reads RVL", () => {
    const { width, height, pixels } = rvlPixels(rvl(DEPTH, WIDTH, HEIGHT));
    expect([width, height, [...pixels]]).toEqual([WIDTH, HEIGHT, [...DEPTH]]);
  });

  it("reads PNG with every filter", async () => {
    const picture = png(DEPTH, WIDTH, HEIGHT);
    expect(isGreyPng(picture)).toBe(true);
    const { width, height, pixels } = await greyPixels(picture);
    expect([width, height, [...pixels]]).toEqual([WIDTH, HEIGHT, [...DEPTH]]);
  });

  it("finds the settings before the picture", () => {
    const data = Uint8Array.from([...settings(10.5, 100), 1, 2, 3]);
    expect(pictureOf({ format: "32FC1; compressedDepth rvl", data })).toEqual({ kind: "depth", encoding: "32FC1", codec: "rvl", quantisation: [10.5, 100], data: Uint8Array.of(1, 2, 3) });
    expect(compressedDepthOf("16UC1; compressedDepth", data)?.codec).toBe("png");
    expect(compressedDepthOf("16UC1; compressedDepth png", data)?.codec).toBe("png");
    expect(compressedDepthOf("rgb8; jpeg compressed bgr8", data)).toBeNull();
    expect(() => compressedDepthOf("16UC1; compressedDepth h264", data)).toThrow("pixels_unknown");
    expect(() => compressedDepthOf("16UC1; compressedDepth", data.subarray(0, 11))).toThrow("picture_unreadable: 11 bytes");
  });

  it("turns inverse depth into metres, and keeps millimetres", () => {
    const [a, b] = [1050, 11];
    const metres = [0.5, 1.25, 7];
    const stored = Uint16Array.from([0, ...metres.map((depth) => Math.round(a / depth + b))]);
    const depth = depthValues({ encoding: "32FC1", codec: "png", quantisation: [a, b], data: new Uint8Array() }, 4, 1, stored);
    expect(depth.unit).toBe("m");
    expect(depth.values[0]).toBeNaN();
    metres.forEach((expected, at) => expect(depth.values[at + 1]).toBeCloseTo(expected, 1));
    const plain = depthValues({ encoding: "16UC1", codec: "png", quantisation: [0, 0], data: new Uint8Array() }, 2, 1, Uint16Array.of(0, 1234));
    expect([[...plain.values], plain.unit]).toEqual([[0, 1234], "mm"]);
  });

  it("refuses damaged pictures", async () => {
    const stream = rvl(DEPTH, WIDTH, HEIGHT);
    expect(() => rvlPixels(stream.subarray(0, 40))).toThrow("picture_unreadable: it is cut off");
    expect(() => rvlPixels(stream.subarray(0, 7))).toThrow("picture_unreadable: 7 bytes");
    const resized = (...size: number[]): Uint8Array => new Uint8Array([...new Uint8Array(Uint32Array.from(size).buffer), ...stream.subarray(8)]);
    expect(() => rvlPixels(resized(WIDTH, HEIGHT - 1))).toThrow("it has more pixels than its size");
    expect(() => rvlPixels(resized(0, 5))).toThrow("picture_unreadable: 0 × 5");
    expect(() => rvlPixels(resized(100_000, 100_000))).toThrow("picture_too_large");
    expect(() => rvlPixels(Uint8Array.from([...stream.subarray(0, 8), ...new Uint8Array(80).fill(0xff)]))).toThrow("a number is too long");

    const picture = png(DEPTH, WIDTH, HEIGHT);
    const changed = (at: number, byte: number): Uint8Array => picture.with(at, byte);
    await expect(greyPixels(changed(23, HEIGHT - 1))).rejects.toThrow("it has more pixels than its size");
    await expect(greyPixels(changed(23, HEIGHT + 1))).rejects.toThrow("it is cut off");
    await expect(greyPixels(changed(16, 1))).rejects.toThrow("picture_too_large");
    await expect(greyPixels(changed(28, 1))).rejects.toThrow("interlaced");
    await expect(greyPixels(changed(65, 0xff))).rejects.toThrow("picture_unreadable");
    await expect(greyPixels(picture.subarray(0, 60))).rejects.toThrow("picture_unreadable");
  });
});
