import { parse } from "@foxglove/rosmsg";
import { MessageWriter } from "@foxglove/rosmsg2-serialization";
import { describe, expect, it } from "vitest";
import { annotationsOf, isAnnotationType, type PathAnnotation, type TextAnnotation } from "./annotations";
import { decoderOf } from "../decoding/decoder";

const RED = { r: 1, g: 0, b: 0, a: 1 };
const HALF_BLUE = { r: 0, g: 0, b: 1, a: 0.5 };
const CLEAR = { r: 0, g: 0, b: 0, a: 0 };
const FOXGLOVE = "foxglove.ImageAnnotations";

function pathOf(path: object): PathAnnotation {
  return annotationsOf(FOXGLOVE, { points: [{ outline_color: RED, thickness: 3, points: [{ x: 1, y: 2 }, { x: 3, y: 4 }], ...path }] }).annotations[0] as PathAnnotation;
}

it("knows the types of annotations", () => {
  const shown = [FOXGLOVE, "foxglove_msgs/msg/ImageAnnotations", "vision_msgs/msg/Detection2DArray", "vision_msgs/Detection2DArray", "vision_msgs/msg/Detection2D"];
  expect(shown.map(isAnnotationType)).toEqual(shown.map(() => true));
  expect(["vision_msgs/msg/Detection3DArray", "constructor", null].map(isAnnotationType)).toEqual([false, false, false]);
});

describe("foxglove.ImageAnnotations", () => {
  it("has points and lines of every kind", () => {
    expect(pathOf({ type: 3 })).toEqual({ kind: "strip", places: [1, 2, 3, 4], outlines: ["rgb(255 0 0 / 1)"], fill: null, thickness: 3 });
    expect([0, 1, 2, 3, 4, "LINE_LOOP", 99].map((type) => pathOf({ type }).kind)).toEqual(["points", "points", "loop", "strip", "segments", "loop", "points"]);
    expect(pathOf({ type: 2, fill_color: HALF_BLUE, outline_color: CLEAR })).toMatchObject({ fill: "rgb(0 0 255 / 0.5)", outlines: [null] });
  });

  it("has colours of single points and segments", () => {
    expect(pathOf({ type: 1, outline_colors: [RED, HALF_BLUE] }).outlines).toEqual(["rgb(255 0 0 / 1)", "rgb(0 0 255 / 0.5)"]);
    const points = [1, 2, 3, 4].map((at) => ({ x: at, y: at }));
    expect(pathOf({ type: 4, points, outline_colors: [RED, HALF_BLUE] }).outlines).toEqual(["rgb(255 0 0 / 1)", "rgb(0 0 255 / 0.5)"]);
    expect(pathOf({ type: 1, outline_colors: [HALF_BLUE] }).outlines).toEqual(["rgb(255 0 0 / 1)"]);
  });

  it("has circles and texts, and the time of the first of them", () => {
    const circle = { position: { x: 5, y: 6 }, diameter: 8, thickness: 0, fill_color: HALF_BLUE, outline_color: RED, timestamp: { sec: 7, nsec: 500_000_000 } };
    const text = { position: { x: 1, y: 20 }, text: "<b>dog</b>", font_size: 14, text_color: RED, background_color: CLEAR };
    expect(annotationsOf(FOXGLOVE, { circles: [circle], texts: [text] })).toEqual({
      stampSeconds: 7.5,
      omittedPoints: 0,
      annotations: [
        { kind: "circle", x: 5, y: 6, radius: 4, outline: "rgb(255 0 0 / 1)", fill: "rgb(0 0 255 / 0.5)", thickness: 1 },
        { kind: "text", x: 1, y: 20, text: "<b>dog</b>", size: 14, colour: "rgb(255 0 0 / 1)", background: null },
      ],
    });
  });

  it("leaves out what has no finite place", () => {
    const nan = { x: Number.NaN, y: 1 };
    const points = [{ x: 1, y: 1 }, nan, { x: 2, y: 2 }, { x: 3, y: 3 }, { x: 4, y: 4 }];
    expect(pathOf({ type: 3, points }).places).toEqual([1, 1, 2, 2, 3, 3, 4, 4]);
    expect(pathOf({ type: 4, points }).places).toEqual([2, 2, 3, 3]);
    const message = { points: [{ type: 1, points: [nan] }], circles: [{ position: nan, diameter: 1 }, { position: { x: 1, y: 1 }, diameter: Infinity }], texts: [{ position: nan, text: "x" }] };
    expect(annotationsOf(FOXGLOVE, message)).toEqual({ stampSeconds: null, annotations: [], omittedPoints: 0 });
    expect(annotationsOf(FOXGLOVE, { points: 5, circles: [null, 3], texts: "x" }).annotations).toEqual([]);
  });

  it("draws 10,000 points at most, and counts the others", () => {
    const points = Array.from({ length: 8_000 }, (_, at) => ({ x: at, y: 0 }));
    const { annotations, omittedPoints } = annotationsOf(FOXGLOVE, { points: [{ type: 1, points }, { type: 1, points }, { type: 1, points }] });
    expect(annotations.map((one) => (one as PathAnnotation).places.length / 2)).toEqual([8_000, 2_000]);
    expect(omittedPoints).toBe(14_000);
  });
});

/** Definitions of vision_msgs and foxglove_msgs of ROS 2, with the fields that are used. */
const DETECTIONS = `std_msgs/Header header
Detection2D[] detections
================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================
MSG: vision_msgs/Detection2D
ObjectHypothesisWithPose[] results
BoundingBox2D bbox
================
MSG: vision_msgs/ObjectHypothesisWithPose
ObjectHypothesis hypothesis
================
MSG: vision_msgs/ObjectHypothesis
string class_id
float64 score
================
MSG: vision_msgs/BoundingBox2D
Pose2D center
float64 size_x
float64 size_y
================
MSG: vision_msgs/Pose2D
Point2D position
float64 theta
================
MSG: vision_msgs/Point2D
float64 x
float64 y
`;
const SHAPES = `PointsAnnotation[] points
================
MSG: foxglove_msgs/PointsAnnotation
builtin_interfaces/Time timestamp
uint8 UNKNOWN=0
uint8 type
Point2[] points
Color outline_color
Color[] outline_colors
float64 thickness
================
MSG: foxglove_msgs/Point2
float64 x
float64 y
================
MSG: foxglove_msgs/Color
float64 r
float64 g
float64 b
float64 a
`;

describe("messages of ROS 2", () => {
  const decoded = (definition: string, name: string, message: object) => {
    const data = new MessageWriter(parse(definition, { ros2: true })).writeMessage(message);
    const decode = decoderOf({ name, encoding: "ros2msg", messageEncoding: "cdr", definition: new TextEncoder().encode(definition) });
    return annotationsOf(name, decode(data));
  };

  it("have the same annotations", () => {
    const bbox = { center: { position: { x: 4, y: 5 }, theta: 0 }, size_x: 2, size_y: 4 };
    const detections = [{ results: [{ hypothesis: { class_id: "dog", score: 0.5 } }], bbox }];
    const boxes = decoded(DETECTIONS, "vision_msgs/msg/Detection2DArray", { header: { stamp: { sec: 9, nanosec: 500_000_000 }, frame_id: "" }, detections });
    expect(boxes.stampSeconds).toBe(9.5);
    expect((boxes.annotations[0] as PathAnnotation).places).toEqual([3, 3, 5, 3, 5, 7, 3, 7]);
    expect((boxes.annotations[1] as TextAnnotation).text).toBe("dog 0.50");
    const points = [{ timestamp: { sec: 4, nanosec: 0 }, type: 2, points: [{ x: 1, y: 2 }, { x: 3, y: 4 }], outline_color: RED, outline_colors: [], thickness: 2 }];
    expect(decoded(SHAPES, "foxglove_msgs/msg/ImageAnnotations", { points })).toEqual({
      stampSeconds: 4,
      omittedPoints: 0,
      annotations: [{ kind: "loop", places: [1, 2, 3, 4], outlines: ["rgb(255 0 0 / 1)"], fill: null, thickness: 2 }],
    });
  });
});

describe("vision_msgs", () => {
  const header = { stamp: { sec: 3, nanosec: 0 } };

  it("draws the boxes of ROS 2 with the best class", () => {
    const results = [{ hypothesis: { class_id: "cat", score: 0.25 } }, { hypothesis: { class_id: "dog", score: 0.75 } }, { hypothesis: { class_id: "x", score: Number.NaN } }];
    const bbox = { center: { position: { x: 50, y: 40 }, theta: 0 }, size_x: 20, size_y: 10 };
    const { stampSeconds, annotations } = annotationsOf("vision_msgs/msg/Detection2DArray", { header, detections: [{ bbox, results }] });
    expect(stampSeconds).toBe(3);
    const [box, label] = annotations as [PathAnnotation, TextAnnotation];
    expect([box.kind, box.places]).toEqual(["loop", [40, 35, 60, 35, 60, 45, 40, 45]]);
    expect(label).toMatchObject({ x: 40, y: 35, text: "dog 0.75", size: null, background: box.outlines[0] });
  });

  it("draws those of ROS 1, turned, and without a class", () => {
    const turned = { bbox: { center: { x: 10, y: 10, theta: Math.PI / 2 }, size_x: 8, size_y: 2 }, results: [{ id: 17, score: 0.5 }] };
    const plain = { bbox: { center: { x: 1, y: 1, theta: 0 }, size_x: 2, size_y: 2 }, results: [] };
    const broken = { bbox: { center: { x: Number.NaN, y: 1, theta: 0 }, size_x: 2, size_y: 2 }, results: [] };
    const [box, label, other, ...more] = annotationsOf("vision_msgs/Detection2DArray", { header, detections: [turned, plain, broken] }).annotations;
    (box as PathAnnotation).places.forEach((place, at) => expect(place).toBeCloseTo([11, 6, 11, 14, 9, 14, 9, 6][at] ?? 0));
    expect((label as TextAnnotation).text).toBe("17 0.50");
    expect([(other as PathAnnotation).places, more]).toEqual([[0, 0, 2, 0, 2, 2, 0, 2], []]);
  });
});
