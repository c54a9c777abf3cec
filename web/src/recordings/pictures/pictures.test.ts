import { describe, expect, it } from "vitest";
import { checkCompressed, isPictureType, pictureOf } from "./picture";
import { pixelsOf, type ColourPixels, type RawPicture } from "./pixels";

function raw(encoding: string, width: number, height: number, data: number[] | Uint8Array, more: Partial<RawPicture> = {}): RawPicture {
  return { width, height, step: 0, encoding, isBigEndian: false, data: Uint8Array.from(data), ...more };
}

function colours(picture: RawPicture): number[][] {
  const { rgba } = pixelsOf(picture) as ColourPixels;
  return Array.from({ length: rgba.length / 4 }, (_, at) => [...rgba.slice(at * 4, at * 4 + 4)]);
}

describe("pixelsOf", () => {
  it.each([
    ["rgb8", [1, 2, 3, 4, 5, 6], [[1, 2, 3, 255], [4, 5, 6, 255]]],
    ["bgr8", [3, 2, 1, 6, 5, 4], [[1, 2, 3, 255], [4, 5, 6, 255]]],
    ["rgba8", [1, 2, 3, 9, 4, 5, 6, 0], [[1, 2, 3, 9], [4, 5, 6, 0]]],
    ["bgra8", [3, 2, 1, 9, 6, 5, 4, 0], [[1, 2, 3, 9], [4, 5, 6, 0]]],
    ["mono8", [7, 200], [[7, 7, 7, 255], [200, 200, 200, 255]]],
    ["yuv422", [128, 50, 128, 60], [[50, 50, 50, 255], [60, 60, 60, 255]]],
    ["yuv422_yuy2", [50, 128, 60, 128], [[50, 50, 50, 255], [60, 60, 60, 255]]],
    ["uyvy", [128, 76, 255, 76], [[254, 0, 76, 255], [254, 0, 76, 255]]],
  ])("reads %s", (encoding, data, expected) => {
    expect(colours(raw(encoding, 2, 1, data))).toEqual(expected);
  });

  it.each([
    ["bayer_rggb8", [10, 20, 40, 30]],
    ["bayer_bggr8", [30, 20, 40, 10]],
    ["bayer_gbrg8", [20, 30, 10, 40]],
    ["bayer_grbg8", [20, 10, 30, 40]],
  ])("gives each pixel of %s the colours of its square", (encoding, square) => {
    expect(colours(raw(encoding, 2, 2, square))).toEqual(Array(4).fill([10, 30, 30, 255]));
  });

  it("skips what fills up a row", () => {
    expect(colours(raw("mono8", 1, 2, [1, 99, 99, 2], { step: 3 }))).toEqual([[1, 1, 1, 255], [2, 2, 2, 255]]);
    expect(colours(raw("bayer_rggb8", 1, 1, [8]))).toHaveLength(1);
  });

  it("refuses pictures that lie about their size", () => {
    expect(() => pixelsOf(raw("rgb8", 100, 100, [1, 2, 3]))).toThrow("picture_unreadable");
    expect(() => pixelsOf(raw("rgb8", 2, 1, [1, 2, 3, 4, 5, 6], { step: 1 }))).toThrow("picture_unreadable");
    expect(() => pixelsOf(raw("mono8", 100_000, 100_000, [1]))).toThrow("picture_too_large");
    expect(() => pixelsOf(raw("mono8", 0, 7, []))).toThrow("picture_unreadable: 0 × 7");
    expect(() => pixelsOf(raw("mono8", 1.5, 2, [1, 2, 3]))).toThrow("picture_unreadable");
    expect(() => pixelsOf(raw("mono8", 1, 2, [1, 2, 3], { step: -1 }))).toThrow("picture_unreadable: rows of -1 bytes");
    expect(() => pixelsOf(raw("16UC1", 2, 2, [1, 2, 3, 4, 5, 6, 7], { step: 5 }))).toThrow("picture_unreadable: 7 bytes");
    expect(() => pixelsOf(raw("mono8", Infinity, 1, [1]))).toThrow("picture_unreadable");
    expect(() => pixelsOf(raw("constructor", 1, 1, [1]))).toThrow("pixels_unknown: constructor");
  });
});

describe("pictureOf", () => {
  const png = [0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10, 0, 0, 0, 13, 73, 72, 68, 82, 0, 0, 2, 0, 0, 0, 1, 0];

  it("knows the types of pictures", () => {
    const shown = ["sensor_msgs/CompressedImage", "sensor_msgs/msg/Image", "foxglove.CompressedImage", "foxglove_msgs/msg/RawImage", "foxglove.CompressedVideo"];
    expect(shown.map(isPictureType)).toEqual(shown.map(() => true));
    expect(["sensor_msgs/Imu", "my_msgs/Image", "my.CompressedVideo", null].map(isPictureType)).toEqual([false, false, false, false]);
  });

  it("finds pictures in bytes and in base64", () => {
    const expected = { kind: "compressed", mime: "image/png", data: Uint8Array.from(png) };
    expect(pictureOf({ format: "png", data: Uint8Array.from(png) })).toEqual(expected);
    expect(pictureOf({ format: "png", data: btoa(String.fromCharCode(...png)) })).toEqual(expected);
    expect(() => pictureOf({ format: "jpeg", data: new Uint8Array() })).toThrow("picture_unreadable: 0 bytes");
    expect(() => pictureOf({ format: "h264", data: Uint8Array.of(0, 0, 0, 1) })).toThrow("pixels_unknown: h264");
    expect(() => pictureOf({ x: 1 })).toThrow("not_a_picture");
  });

  it("refuses what says that it is huge, before it is unpacked", () => {
    const huge = Uint8Array.from(png);
    huge.fill(0x7f, 16, 24);
    expect(() => checkCompressed({ kind: "compressed", mime: "image/png", data: huge })).toThrow("picture_too_large");
    checkCompressed({ kind: "compressed", mime: "image/png", data: Uint8Array.from(png) });
    const jpeg = [0xff, 0xd8, 0xff, 0xe0, 0, 4, 1, 2, 0xff, 0xc2, 0, 11, 8, 1, 0, 2, 0, 1, 1, 0x11, 0];
    checkCompressed({ kind: "compressed", mime: "image/jpeg", data: Uint8Array.from(jpeg) });
    const hugeJpeg = Uint8Array.from(jpeg).fill(255, 13, 17);
    expect(() => checkCompressed({ kind: "compressed", mime: "image/jpeg", data: hugeJpeg })).toThrow("picture_too_large");
    const cut = Uint8Array.from(jpeg.slice(0, 10));
    expect(() => checkCompressed({ kind: "compressed", mime: "image/jpeg", data: cut })).toThrow("picture_unreadable");
  });

  it.each([
    ["lossy", 16_383, [0x20, 0, 0, 0, 0, 0, 0, 0, 0x9d, 1, 0x2a, 0xff, 0x3f, 0xff, 0x3f]],
    ["lossless", 16_384, [0x4c, 0, 0, 0, 0, 0x2f, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0, 0]],
    ["extended", 16_384, [0x58, 10, 0, 0, 0, 0, 0, 0, 0, 0xff, 0x3f, 0, 0xff, 0x3f, 0]],
  ])("refuses a %s WebP of the greatest size", (_, side, header) => {
    const data = Uint8Array.from([...new TextEncoder().encode("RIFF....WEBPVP8"), ...header]);
    expect(() => checkCompressed({ kind: "compressed", mime: "image/webp", data })).toThrow(`picture_too_large: ${side} × ${side}`);
    expect(() => checkCompressed({ kind: "compressed", mime: "image/webp", data: data.subarray(0, 25) })).toThrow("picture_unreadable");
  });
});
