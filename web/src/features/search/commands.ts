// What does on the command line and in Python what the page does, ready to be copied; and terms for the box.
import { type Commands, quoted } from "@/features/file/commands";

/** Returns the commands that search by a text. */
export function searchCommands(query: string): Commands {
  const sdk = [
    "import kleinkram",
    "",
    "with kleinkram.connect() as client:",
    `    for file in client.files.list(${JSON.stringify(query)}):`,
    "        print(file.mission.name, file.path, file.size_bytes)",
  ].join("\n");
  return { cli: `klein search ${query.startsWith("-") ? "-- " : ""}${quoted(query)}`, sdk };
}

/** Returns a script that fetches what a text finds. Nothing that was typed stands in it unquoted. */
export function downloadScript(query: string, server: string, head: string): string {
  return [
    "#!/bin/sh",
    `# ${head}`,
    "set -eu",
    `export KLEINKRAM_URL="\${KLEINKRAM_URL:-${server}}"`,
    `exec klein download --nested --query ${quoted(query)} --dest "\${1:-data}"`,
    "",
  ].join("\n");
}

/** Returns a text with one term more. */
export function withTerm(query: string, key: string, value: string): string {
  const isPlain = value !== "" && !/[\s"\\]/.test(value);
  const said = isPlain ? value : `"${value.replaceAll("\\", "\\\\").replaceAll('"', '\\"')}"`;
  return `${query} ${key}:${said}`.trim();
}

export interface Marked {
  readonly before: string;
  readonly wrong: string;
  readonly after: string;
}

/** Returns a text parted at what is wrong in it. The server counts columns from 1, by characters. */
export function markedAt(text: string, column: number, expression: string): Marked {
  const characters = Array.from(text);
  const rest = characters.slice(column - 1).join("");
  const wrong = expression !== "" && rest.startsWith(expression) ? expression : rest;
  return { before: characters.slice(0, column - 1).join(""), wrong, after: rest.slice(wrong.length) };
}
