import { expect, it } from "vitest";
import { openRecording } from "./formats/open";
import { MessageSearch } from "./message_search";
import type { Which } from "./products/products";
import { madeMcap, storeOf } from "./testing/recordings";

const START = 1_700_000_000_000_000_000n;
const COUNT = 200;
/** A message every 100 ms; every 20th of the rare topic. */
const timeOf = (number: number): bigint => START + BigInt(number) * 100_000_000n;
const topic = (name: string) => ({ name, schema: { name: "T", encoding: "jsonschema", data: new Uint8Array() }, messageEncoding: "json" });

async function searching(maxBytes = Infinity) {
  const messages = Array.from({ length: COUNT }, (_, number) => ({ topic: number % 20 === 10 ? "/rare" : "/busy", logTimeNs: timeOf(number), data: new Uint8Array(2000) }));
  const { ranges } = storeOf(await madeMcap([topic("/rare"), topic("/busy")], messages));
  const recording = await openRecording("mcap", ranges);
  const search = new MessageSearch(recording, { fromNs: timeOf(0), toNs: timeOf(COUNT - 1) });
  const find = async (which: Which, atNs: bigint, name = "/rare") => (await search.find(name, which, atNs, { maxBytes, onDamage: () => undefined })).message?.logTimeNs ?? null;
  return { find, search, read: () => ranges.bytesRead };
}

it("finds the message that is valid, the next, the previous and the nearest one", async () => {
  const { find } = await searching();
  expect(await find("valid", timeOf(49))).toBe(timeOf(30));
  expect(await find("valid", timeOf(50))).toBe(timeOf(50));
  expect(await find("valid", timeOf(9))).toBeNull();
  expect(await find("next", timeOf(50))).toBe(timeOf(70));
  expect(await find("next", timeOf(190))).toBeNull();
  expect(await find("previous", timeOf(50))).toBe(timeOf(30));
  expect(await find("previous", timeOf(10))).toBeNull();
  expect(await find("nearest", timeOf(31))).toBe(timeOf(50));
  expect(await find("nearest", timeOf(199))).toBe(timeOf(190));
});

it("finds the same in any order of times", async () => {
  const { find } = await searching();
  const numbers = Array.from({ length: 60 }, (_, place) => (place * 73) % COUNT);
  for (const number of numbers) {
    const expected = number < 10 ? null : timeOf(Math.floor((number - 10) / 20) * 20 + 10);
    expect([number, await find("valid", timeOf(number))]).toEqual([number, expected]);
  }
});

it("does not read what lies between a message and a later time again", async () => {
  const { find, read } = await searching();
  expect(await find("valid", timeOf(40))).toBe(timeOf(30));
  const before = read();
  expect(await find("valid", timeOf(45))).toBe(timeOf(30));
  expect(await find("valid", timeOf(35))).toBe(timeOf(30));
  expect(read()).toBe(before);
});

it("says how far it searched where it may read no more", async () => {
  const { search } = await searching(-1);
  const { message, searchedToNs } = await search.find("/rare", "valid", timeOf(29), { maxBytes: -1, onDamage: () => undefined });
  expect(message).toBeNull();
  expect(searchedToNs).toBe(timeOf(29) - 250_000_000n);
});

it("knows nothing of what comes behind the beginning of a recording without index", async () => {
  const messages = Array.from({ length: COUNT }, (_, number) => ({ topic: "/busy", logTimeNs: timeOf(number), data: new Uint8Array(2000) }));
  const made = await madeMcap([topic("/busy")], messages);
  const find = async (maxBytes: number) => {
    const recording = await openRecording("mcap", storeOf(made.slice(0, made.length - 3000)).ranges, { maxBytes });
    const span = recording.span ?? { fromNs: 0n, toNs: 0n };
    const search = new MessageSearch(recording, span);
    const at = (atNs: bigint) => search.find("/busy", "valid", atNs, { maxBytes: Infinity, onDamage: () => undefined });
    return { span, within: await at(span.toNs), behind: await at(timeOf(COUNT)) };
  };
  const beginning = await find(made.length / 4);
  expect(beginning.span.toNs).toBeLessThan(timeOf(COUNT / 2));
  expect(beginning.within.message?.logTimeNs).toBe(beginning.span.toNs);
  expect(beginning.behind).toEqual({ message: null, searchedToNs: beginning.span.toNs });
  const whole = await find(Infinity);
  expect(whole.behind.message?.logTimeNs).toBe(whole.span.toNs);
});
