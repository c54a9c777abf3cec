import { describe, expect, it } from "vitest";
import { curvesOf, drawnColumns, pathOf, positionColumns, secondsPerUnit, timeColumn } from "./columns";
import { contentOf, isText } from "./content";
import { cellsOf, delimiterOf, MAX_NUMERIC_COLUMNS, MAX_ROW_COUNT, MAX_ROWS, MAX_SHOWN_COLUMNS, MAX_TABLE_BYTES, readTable, TableReader, type Delimiter, type Table } from "./delimited";
import { pictureSize, pictureType, type PictureType } from "./picture_size";
import { blocksOf, firstPart, formatJson, lastPart, MAX_MATCHES, MAX_SHOWN_BYTES, matchesOf, readText, segmentsOf, STEP_BYTES, visible, withEarlier, withLater } from "./text";
import { viewersOf } from "./viewers";
import type { Source } from "@/recordings/ranges";
import { rowsOf } from "@/features/runs/preview";

const TEXT = new TextEncoder();

function sourceOf(bytes: Uint8Array): Source {
  return { sizeBytes: bytes.length, ahead: 0, bytesRead: 0, read: (offset, length) => Promise.resolve(bytes.subarray(offset, offset + length)) };
}

function tableOf(text: string, delimiter: Delimiter, pieceLength = text.length): Table {
  const reader = new TableReader(delimiter);
  for (let at = 0; at < text.length; at += pieceLength) reader.push(text.slice(at, at + pieceLength));
  return reader.finish(text.length, true);
}

function viewerNames(path: string, head: string | readonly number[], format: string | null = null): string[] {
  const bytes = typeof head === "string" ? TEXT.encode(head) : Uint8Array.from(head);
  return viewersOf(contentOf(path, format, bytes)).map(({ name }) => name);
}

describe("the viewer of a file", () => {
  it("is that of its first bytes, and markup is only text", () => {
    expect(viewerNames("a.svg", '<svg xmlns="http://www.w3.org/2000/svg"><script>alert(1)</script></svg>')).toEqual(["text", "bytes"]);
    expect(viewerNames("a.html", "<!doctype html><script>alert(1)</script>")).toEqual(["text", "bytes"]);
    expect(viewerNames("photo.png", "<svg onload=alert(1)>")).toEqual(["text", "bytes"]);
    expect(viewerNames("a.csv", "a,b\n1,2\n")).toEqual(["table", "text", "bytes"]);
    expect(viewerNames("a.log", "a, b\nc, d\n", "csv")).toEqual(["text", "table", "bytes"]);
    expect(viewerNames("poses.txt", "1 2 3 4 5 6 7 8\n", "tum")).toEqual(["table", "text", "bytes"]);
    expect(viewerNames("a.yaml", "a: 1\n", "yaml")).toEqual(["text", "bytes"]);
    expect(viewerNames("a.txt", [0, 1, 2, 3])).toEqual(["bytes"]);
    expect(viewerNames("a.tiff", [0x49, 0x49, 0x2a, 0])).toEqual(["bytes"]);
    expect(viewerNames("a.bin", [0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10, 0])).toEqual(["picture", "bytes"]);
    expect(viewerNames("a.mp4", [0, 0, 0, 32, 0x66, 0x74, 0x79, 0x70])).toEqual(["video", "bytes"]);
    expect(viewerNames("a.m4a", [0, 0, 0, 32, 0x66, 0x74, 0x79, 0x70])).toEqual(["audio", "bytes"]);
    expect(viewerNames("a.wav", "RIFF\u0001\u0001\u0001\u0001WAVE")[0]).toBe("audio");
    expect(viewerNames("a.pdf", "%PDF-1.7\n")[0]).toBe("pdf");
  });

  it("takes text of other encodings for text, and noise for bytes", () => {
    expect(isText(Uint8Array.from(TEXT.encode("Zürich, 12 °C").slice(0, 2)))).toBe(true); // cut inside of a character
    expect(isText(Uint8Array.from(Array.from("Die Stra\xdfe nach Z\xfcrich ist gesperrt.\n", (letter) => letter.charCodeAt(0))))).toBe(true);
    expect(isText(Uint8Array.from({ length: 4096 }, (_, at) => ((at * 2654435761) >>> 13) % 255 + 1))).toBe(false);
  });
});

describe("a text", () => {
  it("moves through a file in bounded parts", () => {
    const size = 10 * MAX_SHOWN_BYTES;
    let part = firstPart(size);
    for (let steps = 0; part.until < size; steps += 1) {
      const later = withLater(part, size);
      expect(later.until).toBe(part.until + STEP_BYTES);
      expect(later.until - later.from).toBeLessThanOrEqual(MAX_SHOWN_BYTES);
      part = later;
    }
    expect(part.from).toBe(size - MAX_SHOWN_BYTES);
    while (part.from > 0) part = withEarlier(part);
    expect(part).toEqual({ from: 0, until: MAX_SHOWN_BYTES });
    expect(lastPart(size)).toEqual({ from: size - STEP_BYTES, until: size });
    expect([firstPart(10), lastPart(10)]).toEqual([{ from: 0, until: 10 }, { from: 0, until: 10 }]);
  });

  it("leaves out characters that a part cuts, and counts what is not UTF-8", async () => {
    const bytes = TEXT.encode("ä€😀z");
    expect(await readText(sourceOf(bytes), { from: 1, until: 8 })).toEqual({ text: "€", invalid: 0 });
    expect(await readText(sourceOf(bytes), { from: 0, until: bytes.length })).toEqual({ text: "ä€😀z", invalid: 0 });
    expect(await readText(sourceOf(Uint8Array.of(0x61, 0xff, 0x62, 0xc3)), { from: 0, until: 4 })).toEqual({ text: "a\ufffdb\ufffd", invalid: 2 });
    expect(visible("a\u0000\u001b[31m\t\u202eevil\n")).toBe("a␀␛[31m\t⟨U+202E⟩evil\n");
  });

  it("is laid out in small blocks that are the text together", () => {
    const texts = ["", "\n", "a\nb", `${"x".repeat(20_001)}\nend`, "\n".repeat(5000), `${"😀".repeat(9000)}\n${"line\n".repeat(900)}`];
    for (const text of texts) {
      const blocks = blocksOf(text);
      expect(blocks.map((block) => block.text).join("")).toBe(text);
      expect(blocks.every((block) => block.text.length <= 8_000 && block.text.split("\n").length <= 201)).toBe(true);
      expect(blocks.every((block) => block.text === text.slice(block.from, block.from + block.text.length) && !/^[\udc00-\udfff]/.test(block.text))).toBe(true);
    }
  });

  it("is searched regardless of case, also across blocks, up to a limit", () => {
    const text = `${"x".repeat(7_998)}NeEdle (needle.)`;
    const matches = matchesOf(text, "needle");
    expect(matches).toEqual([7_998, 8_006]);
    const segments = blocksOf(text).map((block) => segmentsOf(block, matches, 6));
    expect(segments.flat().map((segment) => segment.text).join("")).toBe(text);
    expect(segments.flat().filter(({ match }) => match === 0).map((segment) => segment.text)).toEqual(["Ne", "Edle"]);
    expect(matchesOf("a.b", ".")).toEqual([1]);
    expect([matchesOf("aaa", ""), matchesOf("a".repeat(5000), "a").length]).toEqual([[], MAX_MATCHES]);
  });

  it("of JSON is formatted with all digits, and refused where it is none", () => {
    expect(formatJson('{"a":[1,{"b":"x:, {\\"\\\\"}],"n":12345678901234567890.10,"e":[],"o":{}}')).toBe(
      '{\n  "a": [\n    1,\n    {\n      "b": "x:, {\\"\\\\"\n    }\n  ],\n  "n": 12345678901234567890.10,\n  "e": [],\n  "o": {}\n}',
    );
    expect([formatJson("12"), formatJson("{"), formatJson("")]).toEqual(["12", null, null]);
    const deep = `${"[".repeat(60)}${"1,".repeat(400_000)}1${"]".repeat(60)}`;
    expect(formatJson(deep)).toBeNull(); // its formatted text would be too long
    expect(JSON.parse(formatJson(deep.slice(0, 100).concat("1", "]".repeat(60))) ?? "0")).toHaveLength(1);
  });
});

describe("a table", () => {
  it("has the cells that an independent reader finds, however its text is divided", () => {
    const text = 'name,note,value\r\n"a ""b""","1\n2, 3",4\nplain,,5.5\n"",x,\n';
    const { rows } = rowsOf(text, 10);
    for (const pieceLength of [1, 3, 7, text.length]) {
      const table = tableOf(text, ",", pieceLength);
      expect([table.names, ...table.rows]).toEqual(rows);
      expect(table.numeric).toEqual([{ name: "value", values: [4, 5.5, NaN] }]);
    }
    expect(cellsOf('a,"b,c",d', ",")).toEqual(["a", "b,c", "d"]);
    expect([delimiterOf("# x\na;b;c\n"), delimiterOf("a\tb\n"), delimiterOf("1 2 3\n"), delimiterOf('"a,b";c\n')]).toEqual([";", "\t", " ", ";"]);
  });

  it("takes its names from the first row, the comment above, or the format of trajectories", () => {
    expect(tableOf("#timestamp [ns],p_RS_R_x [m]\n1403638147895100000,2\n", ",").names).toEqual(["timestamp [ns]", "p_RS_R_x [m]"]);
    expect(tableOf("1 2 3 4 0 0 0 1\n", " ").names).toEqual(["timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]);
    expect(tableOf("1 2\n", " ").names).toEqual(["column 1", "column 2"]);
    expect(tableOf("a,a\n1,2\n", ",").numeric.map(({ name }) => name)).toEqual(["a", "a (2)"]);
  });

  it("is bounded: rows, columns, cells, bytes, and records", async () => {
    const wide = tableOf(`${Array.from({ length: 10_000 }, (_, at) => `c${at}`).join(",")}\n${"1,".repeat(9_999)}1\n`, ",");
    expect([wide.columns, wide.names.length, wide.rows[0]?.length, wide.numeric.length]).toEqual([10_000, MAX_SHOWN_COLUMNS, MAX_SHOWN_COLUMNS, MAX_NUMERIC_COLUMNS]);
    const long = tableOf(`a,b\n${"1,2\n".repeat(1_000)}`, ",");
    expect([long.rows.length, long.rowCount]).toEqual([MAX_ROWS, 1_000]);
    expect(tableOf(`a\n${"x".repeat(1000)}\n`, ",").rows[0]?.[0]).toHaveLength(200);
    const rows = (bytes: number, length: number): Uint8Array => new Uint8Array(bytes).map((_, at) => (at % length === length - 1 ? 0x0a : 0x31));
    const manyBytes = await readTable(sourceOf(rows(MAX_TABLE_BYTES + 64, 64)), ",", () => undefined);
    expect([manyBytes.until, manyBytes.rowCount]).toEqual([MAX_TABLE_BYTES, MAX_TABLE_BYTES / 64]);
    const manyRows = await readTable(sourceOf(rows(MAX_ROW_COUNT * 4, 2)), ",", () => undefined);
    expect(manyRows.rowCount).toBeLessThan(MAX_ROW_COUNT * 1.1);
    expect(manyRows.until).toBe(2 * manyRows.rowCount);
    await expect(readTable(sourceOf(new Uint8Array(4_000_000).fill(0x31)), ",", () => undefined)).rejects.toMatchObject({ code: "too_large" });
    // An open quote does not join all lines behind it, and reading does not take longer the more lines it joins.
    expect(tableOf(`a,b\n"open,1\n${"2,3\n".repeat(400_000)}`, ",", 65_536).rowCount).toBeGreaterThan(140_000);
  }, 30_000);

  it("is drawn over its time in seconds, else over its rows", () => {
    const table = tableOf("stamp_ns,speed,text\n1700000000000000000,1,a\n1700000002000000000,3,b\n1700000001000000000,2,c\n", ",");
    const time = timeColumn(table.numeric);
    expect([time?.name, time && secondsPerUnit(time)]).toEqual(["stamp_ns", 1e-9]);
    const speed = drawnColumns(table.numeric, [], time);
    expect(curvesOf(speed, time, true)).toMatchObject({ seconds: [0, 1, 2], values: [[1, 2, 3]] });
    expect(curvesOf(speed, null, false)).toMatchObject({ seconds: [1, 2, 3], values: [[1, 3, 2]] });
    expect([1.7e9, 1.7e12, 1.7e15, 1.7e18].map((first) => secondsPerUnit({ name: "timestamp", values: [0, first] }))).toEqual([1, 1e-3, 1e-6, 1e-9]);
  });

  it("has the path of its positions, thinned, in the unit of its columns", () => {
    const table = tableOf("0 1 2 0 0 0 0 1\n1 4 6 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n", " ");
    const columns = positionColumns(table);
    expect(columns?.map(({ name }) => name)).toEqual(["tx", "ty"]);
    expect(pathOf(...(columns as NonNullable<typeof columns>))).toMatchObject({ points: 2, start: [0, 0], end: [3, -4], extent: [3, 4] });
    const kitti = positionColumns(tableOf(`${"1 ".repeat(12).trim()}\n`, " "));
    expect(kitti?.map(({ name }) => name)).toEqual(["tx", "tz"]);
    const many = { name: "x", values: Array.from({ length: 100_000 }, (_, at) => at) };
    expect(pathOf(many, many)?.commands.split("L").length).toBeLessThanOrEqual(8_001);
  });
});

describe("the dimensions of a picture", () => {
  async function sizeOf(type: PictureType, bytes: readonly number[]): Promise<unknown> {
    const padded = Uint8Array.from([...bytes, ...Array.from({ length: 64 }, () => 0)]);
    expect(pictureType(padded)).toBe(type);
    return pictureSize(sourceOf(padded), type);
  }
  const PNG = [0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10, 0, 0, 0, 13, 0x49, 0x48, 0x44, 0x52];

  it("are read from its header", async () => {
    expect(await sizeOf("image/png", [...PNG, 0, 0, 2, 128, 0, 0, 1, 224])).toEqual([640, 480]);
    expect(await sizeOf("image/gif", [...TEXT.encode("GIF89a"), 0x80, 2, 0xe0, 1])).toEqual([640, 480]);
    expect(await sizeOf("image/bmp", [0x42, 0x4d, 0, 0, 0, 0, 0, 0, 0, 0, 54, 0, 0, 0, 40, 0, 0, 0, 0x80, 2, 0, 0, 0x20, 0xfe, 0xff, 0xff])).toEqual([640, 480]);
    expect(await sizeOf("image/webp", [...TEXT.encode("RIFF....WEBPVP8X"), 10, 0, 0, 0, 0, 0, 0, 0, 0x7f, 2, 0, 0xdf, 1, 0])).toEqual([640, 480]);
    // Metadata before the frame header, which is longer than the head of the file.
    const metadata = [0xff, 0xe1, 0x20, 0x00, ...Array.from({ length: 0x1ffe }, () => 0x11)];
    expect(await sizeOf("image/jpeg", [0xff, 0xd8, ...metadata, 0xff, 0xc2, 0, 17, 8, 1, 224, 2, 128])).toEqual([640, 480]);
  });

  it("are refused where they are enormous or missing", async () => {
    await expect(sizeOf("image/png", [...PNG, 0, 1, 0, 0, 0, 1, 0, 0])).rejects.toMatchObject({ code: "picture_too_large", detail: "65536 × 65536" });
    await expect(sizeOf("image/png", [...PNG, 0, 0, 0, 0, 0, 0, 0, 0])).rejects.toMatchObject({ code: "picture_unreadable" });
    await expect(sizeOf("image/jpeg", [0xff, 0xd8, 0xff, 0xe0, 0, 0])).rejects.toMatchObject({ code: "picture_unreadable" });
    await expect(pictureSize(sourceOf(Uint8Array.from(PNG)), "image/png")).rejects.toMatchObject({ code: "picture_unreadable" });
  });
});
