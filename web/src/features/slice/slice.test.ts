import { describe, expect, it } from "vitest";
import { commandOf, commandOfSeveral, rangeIn, removeEmpty, splitRecording } from "./selection";
import type { File, Recording } from "@/api/types";

const MISSION = { id: "m", name: "day", project: { id: "p", name: "Alps" } };
const FILE = { id: "f", path: "nuc/drive_0.mcap", mission: MISSION } as File;
const TIMES = { startNs: 5n, endNs: null };

describe("the command", () => {
  it("makes the same file", () => {
    expect(commandOf(FILE, null, ["/imu"], TIMES)).toBe("klein cut nuc/drive_0.mcap -p Alps -m day --topics /imu --start 5 -o drive_0.slice.mcap");
  });

  it("names topics with spaces and commas by a glob, because the command separates topics by them", () => {
    expect(commandOf(FILE, null, ["/GPS fix, raw"], TIMES)).toContain("--topics '/GPS?fix??raw' ");
  });

  it("of several files names each of them, whatever characters its name has", () => {
    expect(commandOfSeveral(["a.mcap", "-b[1].bag"], MISSION)).toBe("klein cut a.mcap '[-]b[[]1].bag' -p Alps -m day --topics /TOPIC --start +10s --end +20s -o selection.mcap");
  });
});

it("begins with the range of an address, as far as the recording has it", () => {
  const span = { fromNs: 1_000_000_000n, toNs: 3_000_000_000n };
  expect(rangeIn("1500000000-2000000000", span)).toEqual({ fromMs: 500, toMs: 1000 });
  expect(rangeIn("0-9000000000", span)).toEqual({ fromMs: 0, toMs: 2000 });
  for (const text of ["", "1", "5-", "2000000000-1500000000", "4000000000-5000000000"]) expect(rangeIn(text, span)).toBeNull();
});

describe("a file of a recording", () => {
  const recordingOf = (...paths: string[]) => ({ name: "nuc", file_ids: ["e", "f"], paths }) as unknown as Recording;

  it("is one of several", () => {
    const split = splitRecording(FILE, [recordingOf("nuc/metadata.yaml", "nuc/drive_0.mcap", "nuc/drive_1.mcap")]);
    expect(split).toEqual({ name: "nuc", files: 2 });
    expect(commandOf(FILE, split, null, TIMES)).toContain("klein cut nuc -p Alps -m day ");
  });

  it("is the only one that has messages", () => {
    expect(splitRecording(FILE, [recordingOf("nuc/metadata.yaml", "nuc/drive_0.mcap")])).toBeNull();
    expect(splitRecording(FILE, [])).toBeNull();
  });
});

describe("the file of a slice that was not made", () => {
  const removalOf = async (size: number, remove: () => Promise<void>): Promise<void> =>
    removeEmpty({ getFile: () => Promise.resolve({ size }), remove } as unknown as FileSystemFileHandle);

  it("is removed if it is empty", async () => {
    let removals = 0;
    const remove = (): Promise<void> => Promise.resolve(void (removals += 1));
    await removalOf(3, remove);
    expect(removals).toBe(0);
    await removalOf(0, remove);
    expect(removals).toBe(1);
  });

  it("stays where the browser does not allow that", async () => {
    await expect(removalOf(0, () => Promise.reject(new DOMException("", "NoModificationAllowedError")))).resolves.toBeUndefined();
  });
});
