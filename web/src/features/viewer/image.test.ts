import { expect, it } from "vitest";
import { pixelAt, valueAt, valueText } from "./image/pixel_values";
import { annotationTopicFor, colourMapOf, imageSettings, pictureTable, shownRange } from "./image/settings";
import { panelOf, panelText, type Series } from "./layout";
import { withOption } from "./scene/settings";
import { pictureValues } from "@/recordings/pictures/values";

const series = { recording: "k", topic: "/depth", fields: [] };

it("keeps its settings in the address", () => {
  const options = [["map", "viridis"], ["least", "0.5"], ["greatest", "-3"], ["annotations", "/a=b,c"]] as const;
  const changed = options.reduce<Series>((one, [name, value]) => withOption(one, name, value), series);
  const text = panelText({ kind: "image", isWide: false, series: [changed] });
  expect(imageSettings(panelOf(text)?.series[0])).toEqual({ colourMap: "viridis", least: 0.5, greatest: -3, annotations: "/a=b,c" });
  expect(imageSettings(withOption(series, "annotations", "")).annotations).toBe("");
  expect(imageSettings({ ...series, fields: ["map=constructor", "least=x", "greatest="] })).toEqual({ colourMap: null, least: null, greatest: null, annotations: null });
  expect(imageSettings(undefined).annotations).toBeNull();
});

it("colours distances, and shows brightness grey", () => {
  const automatic = imageSettings(series);
  expect([colourMapOf(automatic, { unit: "mm" }), colourMapOf(automatic, { unit: "m" }), colourMapOf(automatic, { unit: null })]).toEqual(["turbo", "turbo", "grey"]);
  expect(colourMapOf({ ...automatic, colourMap: "viridis" }, { unit: null })).toBe("viridis");
  expect([...pictureTable("grey").slice(0, 8)]).toEqual([0, 0, 0, 255, 1, 1, 1, 255]);
  expect(pictureTable("turbo")).toHaveLength(1024);
});

it("takes each end of the range from the settings, or from the picture", () => {
  const automatic = imageSettings(series);
  expect(shownRange(automatic, { range: [1, 9] })).toEqual([1, 9]);
  expect(shownRange({ ...automatic, greatest: 4 }, { range: [1, 9] })).toEqual([1, 4]);
  expect(shownRange({ ...automatic, least: 2, greatest: 4 }, { range: null })).toEqual([2, 4]);
  expect(shownRange({ ...automatic, least: 2 }, { range: null })).toBeNull();
});

it("chooses annotations in the namespace of the camera", () => {
  const topics = ["/detections", "/camera/all", "/camera/rear/detections", "/camera/front/detections"];
  expect(annotationTopicFor("/camera/front/image/compressed", topics)).toBe("/camera/front/detections");
  expect(annotationTopicFor("/camera/left/image", topics)).toBe("/camera/all");
  expect(annotationTopicFor("/camera2/image", topics)).toBeNull();
});

it("finds the pixel under the pointer in a picture that is fitted into its box", () => {
  const box = { width: 400, height: 200 };
  expect(pixelAt({ x: 100, y: 0 }, box, { width: 100, height: 100 })).toEqual({ x: 0, y: 0 });
  expect(pixelAt({ x: 299, y: 199 }, box, { width: 100, height: 100 })).toEqual({ x: 99, y: 99 });
  expect(pixelAt({ x: 99, y: 50 }, box, { width: 100, height: 100 })).toBeNull();
  expect(pixelAt({ x: 200, y: 100 }, box, { width: 800, height: 400 })).toEqual({ x: 400, y: 200 });
});

it("says the value of a pixel", () => {
  const picture = pictureValues(2, 2, Float32Array.of(0, 1.25, Number.NaN, 0.1), "m");
  expect([valueAt(picture, { x: 0, y: 0 }), valueAt(picture, { x: 1, y: 0 }), valueAt(picture, { x: 0, y: 1 })]).toEqual([null, 1.25, null]);
  expect(valueText(valueAt(picture, { x: 1, y: 1 }) ?? 0, "m")).toBe("0.1 m");
  expect(valueText(65_535, null)).toBe("65535");
});
