/** Definitions of common ROS 2 types, for recordings without definitions: those of the server's reader. */

import lines from "../../../../src/kleinkram/recordings/decoding/well_known.txt?raw";

const SEPARATOR = "=".repeat(80);
let known: ReadonlyMap<string, readonly string[]> | null = null;

/** The definitions by short names, such as "sensor_msgs/Imu": that of Humble first, then those of other releases. */
function knownDefinitions(): ReadonlyMap<string, readonly string[]> {
  if (known !== null) return known;
  const definitions = new Map<string, string[]>();
  for (const line of lines.split("\n")) {
    const mark = line.indexOf(":");
    if (mark < 0 || line.startsWith("#")) continue;
    const name = line.slice(0, mark);
    const text = line.slice(mark + 1).trim().replaceAll("; ", "\n");
    definitions.set(name, [...(definitions.get(name) ?? []), text]);
  }
  known = definitions;
  return definitions;
}

/** Return the texts that may define a type ("sensor_msgs/msg/Imu"), the default first; none for other types.
 *
 * Each text has all types behind it that the type needs; each but the first takes one of them from another release.
 */
export function wellKnownDefinitions(name: string): string[] {
  const definitions = knownDefinitions();
  const root = name.replace("/msg/", "/");
  if (!definitions.has(root)) return [];
  const needed = [root];
  // Grows by all that any definition mentions.
  for (const one of needed) {
    const [owner = ""] = one.split("/");
    for (const line of (definitions.get(one) ?? []).flatMap((text) => text.split("\n"))) {
      const type = /^[\w/]+/.exec(line)?.[0] ?? "";
      const full = type.includes("/") ? type : `${owner}/${type}`;
      if (definitions.has(full) && !needed.includes(full)) needed.push(full);
    }
  }
  const usual = new Map(needed.map((one) => [one, definitions.get(one)?.[0] ?? ""]));
  const others = needed.flatMap((one) => (definitions.get(one) ?? []).slice(1).map((text) => new Map(usual).set(one, text)));
  return [usual, ...others].map((texts) => {
    const behind = [...texts].filter(([one]) => one !== root).map(([one, text]) => `${SEPARATOR}\nMSG: ${one}\n${text}`);
    return [texts.get(root) ?? "", ...behind].join("\n");
  });
}
