import { expect, it } from "vitest";
import { chosenCurves, curveKey, curveName, curveOf, curveText, isDerived, vectorPaths, withRecording, type PlotCurve } from "./plot_curves";
import { unitOf, unitOfCurve } from "./units";
import type { FieldNode } from "@/recordings/decoding/fields";

function leaf(path: string): FieldNode {
  return { label: /(\[\d+\]|\w+)$/.exec(path)?.[0] ?? path, path, children: [], hidden: 0 };
}

function group(label: string, children: FieldNode[], hidden = 0): FieldNode {
  return { label, path: null, children, hidden };
}

const IMU = [
  group("orientation", ["x", "y", "z", "w"].map((name) => leaf(`orientation.${name}`))),
  group("linear_acceleration", ["x", "y", "z"].map((name) => leaf(`linear_acceleration.${name}`))),
  group("covariance", Array.from({ length: 9 }, (_, at) => leaf(`covariance[${at}]`))),
  group("pair", [leaf("pair[0]"), leaf("pair[1]")]),
  leaf("temperature"),
];
const OTHER: PlotCurve = { column: "a.x", minus: { recording: "04cf00a6", topic: "/t,o;p!c", field: 'b["(,)"]' }, side: "right" };

it("writes curves into layouts and reads the same", () => {
  const curves = ["a.x", "a.x@right", "norm(a)", "derivative(a.x)@right", "difference(a.x,b)", 'odd["@right"]'].map(curveOf);
  expect(curves.map(({ side }) => side)).toEqual(["left", "right", "left", "right", "left", "left"]);
  expect(curves.map(curveText).map(curveOf)).toEqual(curves);
  expect(curveOf(curveText(OTHER))).toEqual(OTHER);
  expect(curveKey(curveOf("a.x@right"))).toBe("a.x");
});

it("names curves for people", () => {
  expect(["a.x", "norm(a)", "derivative(a.x)@right", "difference(a.x,b)"].map(curveOf).map(curveName)).toEqual(["a.x", "|a|", "d/dt a.x", "a.x − b"]);
  expect(curveName(OTHER)).toBe('a.x − /t,o;p!c b["(,)"]');
  expect([curveOf("a.x"), curveOf("norm(a)"), OTHER].map(isDerived)).toEqual([false, true, true]);
});

it("puts other recordings into curves", () => {
  expect(withRecording("a.x@right", () => "new")).toBe("a.x@right");
  expect(curveOf(withRecording(curveText(OTHER), () => "2") ?? "").minus?.recording).toBe("2");
  expect(withRecording(curveText(OTHER), () => null)).toBeNull();
});

it("finds vectors", () => {
  expect(vectorPaths(IMU)).toEqual(["orientation", "linear_acceleration", "pair"]);
  expect(vectorPaths(["x", "y", "z"].map(leaf))).toEqual([""]);
});

it("draws the curves that a topic has, else the defaults", () => {
  const texts = (selected: string[]): string[] => chosenCurves(IMU, selected, "sensor_msgs/msg/Imu").map(curveText);
  expect(texts(["norm(orientation)@right", "temperature", "gone", "norm(gone)", "derivative(gone)", "difference(temperature,gone)"])).toEqual(["norm(orientation)@right", "temperature"]);
  expect(texts(["derivative(temperature)", "difference(temperature,pair[1])"])).toEqual(["derivative(temperature)", "difference(temperature,pair[1])"]);
  expect(texts(["gone"])).toEqual(["x", "y", "z"].map((name) => `linear_acceleration.${name}`));
});

it("knows units of well-known types only", () => {
  expect(unitOf("sensor_msgs/msg/Imu", "linear_acceleration.x")).toBe("m/s²");
  expect(unitOf("sensor_msgs/Imu", "angular_velocity.z")).toBe("rad/s");
  expect(unitOf("nav_msgs/msg/Odometry", "pose.pose.position.x")).toBe("m");
  expect(unitOf("nav_msgs/msg/Odometry", "twist.twist.angular.z")).toBe("rad/s");
  expect(unitOf("sensor_msgs/msg/NavSatFix", "latitude")).toBe("°");
  expect(unitOf("sensor_msgs/msg/BatteryState", "cell_voltage[3]")).toBe("V");
  expect(unitOf("sensor_msgs/msg/Temperature", "temperature")).toBe("°C");
  for (const [type, path] of [["my_msgs/msg/Imu", "linear_acceleration.x"], ["sensor_msgs/msg/Imu", "linear_acceleration_covariance[0]"], ["nav_msgs/msg/Odometry", "pose.pose.orientation.x"], [null, "x"], ["__proto__", "x"]] as const) {
    expect(unitOf(type, path)).toBeNull();
  }
});

it("computes units of curves", () => {
  const typeOf = (_: string, topic: string): string => (topic === "/odom" ? "nav_msgs/msg/Odometry" : "other/Type");
  const unit = (text: string, type = "sensor_msgs/msg/Imu"): string | null => unitOfCurve(curveOf(text), type, typeOf);
  expect(unit("norm(linear_acceleration)")).toBe("m/s²");
  expect(unit("derivative(linear_acceleration.x)@right")).toBe("m/s³");
  expect(unit("derivative(voltage)", "sensor_msgs/msg/BatteryState")).toBe("(V)/s");
  expect(unit("difference(linear_acceleration.x,linear_acceleration.y)")).toBe("m/s²");
  expect(unit("difference(linear_acceleration.x,angular_velocity.y)")).toBeNull();
  expect(unit("difference(pose.pose.position.x,r@/odom,pose.pose.position.x)", "nav_msgs/msg/Odometry")).toBe("m");
  expect(unit("difference(pose.pose.position.x,r@/else,pose.pose.position.x)", "nav_msgs/msg/Odometry")).toBeNull();
});
