import { describe, expect, it, vi } from "vitest";
import { coverage, hasRight, viewerAddress } from "./queries";
import { chosenFields, csvOf, rangeOf, rowsOf, shortNumber } from "./viewer/plot";
import { defaultTopic } from "./viewer/viewers";
import { latest } from "./viewer/useReader";
import type { File, Topic } from "@/api/types";
import { fileCommands, quoted } from "@/components/commands";
import { fieldTree } from "@/recordings/decoding/fields";

function topic(name: string, messageType: string, count: number | null, more: Partial<Topic> = {}): Topic {
  return { name, message_type: messageType, count, first_ns: null, last_ns: null, ...more } as Topic;
}

const FILE = { id: "1", path: "a b/it's.mcap", mission: { name: "day", project: { name: "Alps" } }, start_ns: 0, end_ns: 120 } as File;

describe("commands", () => {
  it("quotes what a shell would take apart", () => {
    expect(quoted("plain/drive-1.mcap")).toBe("plain/drive-1.mcap");
    expect(fileCommands(FILE).cli).toBe(`klein download 'a b/it'\\''s.mcap' -p Alps -m day`);
    expect(quoted("$(rm -rf ~)")).toBe("'$(rm -rf ~)'");
    expect(quoted("")).toBe("''");
  });

  it("puts the address of a recording into that of a viewer", () => {
    const template = "https://viewer.example/?ds=remote-file&ds.url={url}";
    expect(viewerAddress(template, "http://s/x?a=1&b=$&")).toBe("https://viewer.example/?ds=remote-file&ds.url=http%3A%2F%2Fs%2Fx%3Fa%3D1%26b%3D%24%26");
  });
});

describe("what is shown first", () => {
  const topics = [topic("/imu", "sensor_msgs/msg/Imu", 900), topic("/empty", "sensor_msgs/msg/Image", 0), topic("/cam", "sensor_msgs/msg/Image", 3)];

  it("is what the address says, else pictures, else the busiest topic", () => {
    expect(defaultTopic(topics, "/imu")?.name).toBe("/imu");
    expect(defaultTopic(topics, "/gone")?.name).toBe("/cam");
    expect(defaultTopic(topics.slice(0, 2), "")?.name).toBe("/imu");
    expect(defaultTopic([], "")).toBeNull();
  });

  it("of a message is what one wants to see of it, and never its header", () => {
    const acceleration = fieldTree({ header: { stamp: 1 }, linear_acceleration: { x: 1, y: 2, z: 3 } });
    expect(chosenFields(acceleration, [], "sensor_msgs/msg/Imu")).toEqual(["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]);
    const other = fieldTree({ header: { seq: 1, stamp: 2 }, covariance: Float64Array.of(1, 2), speed: 3, deep: { a: 1 } });
    expect(chosenFields(other, [], "pkg/Thing")).toEqual(["speed"]);
    expect(chosenFields(other, ["deep.a", "gone"], "pkg/Thing")).toEqual(["deep.a"]);
    expect(chosenFields(fieldTree({ header: { stamp: 2 } }), [], null)).toEqual(["header.stamp"]);
    expect(chosenFields([], ["x"], null)).toEqual([]);
  });
});

describe("values", () => {
  it("become rows and CSV with every digit, without what only breaks a curve", () => {
    const rows = rowsOf([0.1, 0.2, 0.3], [[1, null, undefined], [undefined, null, 1 / 3]]);
    expect(rows.map(({ seconds }) => seconds)).toEqual([0.1, 0.3]);
    expect(csvOf(['a"b', "c,d"], rows, 5n)).toBe(`seconds since 5 ns,"a""b","c,d"\n0.1,1,\n0.3,,${1 / 3}\n`);
    expect(rangeOf([3, null, -1, undefined])).toEqual([-1, 3]);
    expect(rangeOf([null])).toBeNull();
  });

  it("are short enough to read", () => {
    expect([0, 9.806650000001, 1 / 3, 1e-9, 12345678.9, 300, null].map(shortNumber)).toEqual(["0", "9.80665", "0.3333333", "1.00000e-9", "1.23457e+7", "300", "–"]);
  });
});

describe("coverage", () => {
  it("is full between a topic's first and last message", () => {
    const parts = coverage(topic("/a", "x", 2, { first_ns: 60, last_ns: 120 }), FILE);
    expect([parts.indexOf(1), parts.filter((part) => part === 1).length, parts.length]).toEqual([60, 60, 120]);
    expect(coverage(topic("/a", "x", 0), FILE)).toEqual([]);
  });
});

describe("rights", () => {
  it("reach what is below them", () => {
    expect(hasRight("DELETE", "WRITE")).toBe(true);
    expect(hasRight("CREATE", "WRITE")).toBe(false);
    expect(hasRight(undefined, "READ")).toBe(false);
  });
});

describe("latest", () => {
  it("does one at a time, and of what waits only the last", async () => {
    const done: number[] = [];
    const ask = latest(async (value: number) => {
      await Promise.resolve();
      done.push(value);
    });
    [1, 2, 3, 4].forEach(ask);
    await vi.waitFor(() => expect(done).toEqual([1, 4]));
  });
});
