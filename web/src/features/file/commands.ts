// CLI and SDK commands for one file.
import type { File } from "@/api/types";

const PLAIN = /^[\w@%+=:,./-]+$/;

/** Returns a word as a shell takes it literally. */
export function quoted(word: string): string {
  return PLAIN.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`;
}

export interface Commands {
  readonly cli: string;
  readonly sdk: string;
}

export function commandsOf(file: File): Commands {
  const sdk = [
    "import kleinkram",
    "",
    "with kleinkram.connect() as client:",
    `    with client.recordings.open(${JSON.stringify(file.id)}) as recording:`,
    "        for topic in recording.topics:",
    "            print(topic.name, topic.message_type, topic.count)",
  ].join("\n");
  const place = `-p ${quoted(file.mission.project.name)} -m ${quoted(file.mission.name)}`;
  return { cli: `klein download ${quoted(file.path)} ${place}`, sdk };
}

/** Returns the address of a viewer with that of a recording in it. */
export function viewerAddress(template: string, recording: string): string {
  return template.replaceAll("{url}", encodeURIComponent(recording));
}
