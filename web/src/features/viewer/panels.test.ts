import { expect, it } from "vitest";
import { defaultLayout, kindsFor, panelKinds } from "./panels";
import type { ViewerTopic } from "./queries";

const topic = (name: string, messageType: string, count = 100, recording = "a"): ViewerTopic => ({ recording, name, messageType, count, firstNs: 0, density: [] });
const layout = (...topics: ViewerTopic[]) => defaultLayout(topics).map(({ kind, series, isWide }) => `${kind}${isWide ? "*" : ""} ${series[0]?.topic}`);

it("has kinds whose names are unique and fit into addresses", () => {
  const kinds = panelKinds.map(({ kind }) => kind);
  expect(new Set(kinds).size).toBe(kinds.length);
  expect(kinds.every((kind) => /^[a-z]+$/.test(kind))).toBe(true);
});

it("shows cameras, a plot, a message and a log at first", () => {
  const topics = [topic("/log", "rosgraph_msgs/Log"), topic("/left", "sensor_msgs/Image"), topic("/right", "sensor_msgs/msg/CompressedImage"), topic("/imu", "sensor_msgs/msg/Imu", 900)];
  expect(layout(...topics)).toEqual(["image /left", "image /right", "plot* /imu", "raw /imu", "log /log"]);
});

it("leaves no panel alone in its row", () => {
  expect(layout(topic("/left", "sensor_msgs/Image"), topic("/imu", "sensor_msgs/msg/Imu", 900))).toEqual(["image /left", "raw /imu", "plot* /imu"]);
  expect(layout(topic("/imu", "sensor_msgs/msg/Imu"))).toEqual(["plot* /imu", "raw* /imu"]);
});

it("shows the plot in the second row, however much there is", () => {
  const cameras = ["/a", "/b", "/c"].map((name) => topic(name, "sensor_msgs/Image"));
  const topics = [topic("/points", "sensor_msgs/PointCloud2"), topic("/gps", "sensor_msgs/NavSatFix"), topic("/imu", "sensor_msgs/Imu", 900)];
  expect(layout(...topics, ...cameras)).toEqual(["image /a", "image /b", "plot* /imu", "image /c", "scene /points", "map /gps", "raw /imu"]);
  expect(layout(...topics, ...cameras.slice(0, 1))).toEqual(["image /a", "scene /points", "plot* /imu", "map /gps", "raw /imu"]);
});

it("shows a topic of several recordings once, and no topic without messages", () => {
  expect(layout(topic("/left", "sensor_msgs/Image", 5, "a"), topic("/left", "sensor_msgs/Image", 5, "b"), topic("/right", "sensor_msgs/Image", 0))).toEqual(["image /left", "raw /left"]);
});

it("offers the panels that show a type", () => {
  const kinds = (type: string) => kindsFor(topic("/t", type)).map(({ kind }) => kind);
  expect(kinds("sensor_msgs/Image")).toEqual(["image", "raw"]);
  expect(kinds("rcl_interfaces/msg/Log")).toEqual(["plot", "raw", "log", "states", "table"]);
  expect(kinds("my_msgs/Anything")).toEqual(["plot", "raw", "states", "table"]);
  expect(kinds("sensor_msgs/NavSatFix")).toEqual(["map", "plot", "raw", "states", "table"]);
  expect(kinds("tf2_msgs/msg/TFMessage")).toEqual(["plot", "raw", "table", "tf"]);
});
