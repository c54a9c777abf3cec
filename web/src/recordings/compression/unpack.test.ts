import { beforeAll, describe, expect, it } from "vitest";
import { ReadFailure } from "../failures";
import { MAX_UNPACKED } from "../limits";
import { prepareUnpacking, unpack } from "./unpack";

// What the tools of each format (bzip2, lz4, zstd) make of these bytes.
const PLAIN = new Uint8Array([
  ...Array.from({ length: 2000 }, (_, at) => Math.floor(at / 50) % 256),
  ...new TextEncoder().encode("the same, the same, the same"),
]);
const PACKED: Record<string, string> = {
  bz2: "QlpoOTFBWSZTWV9jnIMAAABxgH//////hSJCDAAgAJIV6VDQMg0BiAMRveqoekO/8qoZNBkZMQGg0BoMfU+YhxjAMI5BiHKOYc46BjGQdI6hlGYdYzjQNI7B2juHePAeI1DyHmPQeo1laIYbE1qb0m9prkzphZoAAAAAAAAAAAO7u73RUYpoXq9TKEf4u5IpwoSC+xzkGA==",
  lz4: "BCJNGGhA7AcAAAAAAAA02wAAAB8AAQAeHwEBAB4fAgEAHh8DAQAeHwQBAB4fBQEAHh8GAQAeHwcBAB4fCAEAHh8JAQAeHwoBAB4fCwEAHh8MAQAeHw0BAB4fDgEAHh8PAQAeHxABAB4fEQEAHh8SAQAeHxMBAB4fFAEAHh8VAQAeHxYBAB4fFwEAHh8YAQAeHxkBAB4fGgEAHh8bAQAeHxwBAB4fHQEAHh8eAQAeHx8BAB4fIAEAHh8hAQAeHyIBAB4fIwEAHh8kAQAeHyUBAB4fJgEAHh8nAQAeqXRoZSBzYW1lLCAKAFAgc2FtZQAAAAA=",
  zstd: "KLUv/WDsBtUDADQDAAABAgMEBQYHCAkKCwwNDg8QERITFBUWFxgZGhscHR4fICEiIyQlJid0aGUgc2FtZSwgKSDg1/XQ6IyYkRidETMSozNiRmJ0jpiRGJ0RMxKjM2JGYnRGzEiMzogZidEZMSMxOiNmJIrOiBmJ0RkxIzE6I2YkihAW",
};

function packed(name: string): Uint8Array {
  return Uint8Array.from(atob(PACKED[name] ?? ""), (letter) => letter.charCodeAt(0));
}

function codeOf(act: () => unknown): string {
  try {
    act();
  } catch (thrown) {
    if (thrown instanceof ReadFailure) return thrown.code;
    throw thrown;
  }
  return "no failure";
}

describe("unpack", () => {
  beforeAll(prepareUnpacking);

  it.each(Object.keys(PACKED))("reads what %s wrote", (name) => {
    expect(unpack(name, packed(name), PLAIN.length)).toEqual(PLAIN);
  });

  it.each(Object.keys(PACKED))("refuses %s that holds more or less than the chunk says", (name) => {
    for (const size of [PLAIN.length - 1, PLAIN.length + 1, 0]) {
      expect(codeOf(() => unpack(name, packed(name), size))).toBe("chunk_damaged");
    }
  });

  it.each(Object.keys(PACKED))("names the failure, whatever byte of %s is changed or missing", (name) => {
    const whole = packed(name);
    for (let at = 0; at < whole.length; at++) {
      const changed = whole.slice();
      changed[at] = (changed[at] ?? 0) ^ 0x55;
      for (const bytes of [changed, whole.slice(0, at)]) {
        const code = codeOf(() => unpack(name, bytes, PLAIN.length));
        expect(["chunk_damaged", "no failure"]).toContain(code);
      }
    }
  });

  it("refuses what is larger than anybody should hold, and what it does not know", () => {
    expect(codeOf(() => unpack("zstd", packed("zstd"), MAX_UNPACKED + 1))).toBe("too_large");
    expect(codeOf(() => unpack("brotli", packed("zstd"), 10))).toBe("compression_unknown");
  });

  it("gives back what is not compressed", () => {
    expect(unpack("none", PLAIN, PLAIN.length)).toBe(PLAIN);
    expect(codeOf(() => unpack("", PLAIN, 3))).toBe("chunk_damaged");
  });
});
