// CLI and SDK commands that do what a page does. User input in them is quoted.
import type { File, Run } from "@/api/types";

const PLAIN = /^[\w@%+=:,./-]+$/;
const GLOB = /[*?[\]]/;

export interface Commands {
  readonly cli: string;
  readonly sdk: string;
}

interface NamedMission {
  readonly id: string;
  readonly name: string;
  readonly project: { readonly name: string };
}

/** Returns a word as a shell takes it literally. */
export function quoted(word: string): string {
  return PLAIN.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`;
}

/** Returns the arguments that name a mission. The CLI takes names as patterns, so a name with `*` is replaced by the ID. */
export function missionArguments({ id, name, project }: NamedMission): string {
  return GLOB.test(project.name + name) ? `-m ${id}` : `-p ${quoted(project.name)} -m ${quoted(name)}`;
}

/** Returns the arguments that name files of a mission. */
export function fileArguments(files: readonly { readonly id: string; readonly path: string }[]): readonly string[] {
  return files.map(({ id, path }) => (GLOB.test(path) || path.startsWith("-") ? id : quoted(path)));
}

function sdk(...lines: readonly string[]): string {
  return ["import kleinkram", "", "with kleinkram.connect() as client:", ...lines.map((line) => `    ${line}`)].join("\n");
}

/** The commands that download a file, and list its topics. */
export function fileCommands(file: File): Commands {
  return {
    cli: `klein download ${quoted(file.path)} -p ${quoted(file.mission.project.name)} -m ${quoted(file.mission.name)}`,
    sdk: sdk(
      `with client.recordings.open(${JSON.stringify(file.id)}) as recording:`,
      "    for topic in recording.topics:",
      "        print(topic.name, topic.message_type, topic.count)",
    ),
  };
}

/** The commands that download selected files of a mission, or the entire mission if no file is selected. */
export function missionCommands(mission: NamedMission, selected: readonly { readonly id: string; readonly path: string }[]): Commands {
  const cli = ["klein download", ...fileArguments(selected), missionArguments(mission)].join(" ");
  if (selected.length === 0) {
    return {
      cli,
      sdk: sdk(
        `mission = client.missions.get(${JSON.stringify(mission.id)})`,
        "for recording in client.recordings.list(mission.id):",
        "    print(recording.name, recording.message_count, recording.size_bytes)",
      ),
    };
  }
  const ids = selected.map(({ id }) => `    ${JSON.stringify(id)},`);
  return { cli, sdk: sdk("for file_id in [", ...ids, "]:", "    file = client.files.get(file_id)", "    print(file.path, file.message_count, file.size_bytes)") };
}

/** The commands that run a search. */
export function searchCommands(query: string): Commands {
  return {
    cli: `klein search ${query.startsWith("-") ? "-- " : ""}${quoted(query)}`,
    sdk: sdk(`for file in client.files.list(${JSON.stringify(query)}):`, "    print(file.mission.name, file.path, file.size_bytes)"),
  };
}

/** The commands that show a run and its log, and download its artifacts. */
export function runCommands(run: Run): Commands {
  return {
    cli: [`klein run info ${run.id}`, `klein run logs ${run.id} -f`, `klein run artifacts ${run.id} --download DIRECTORY`].join("\n"),
    sdk: sdk(`run = client.runs.get(${JSON.stringify(run.id)})`, "print(run.state, run.message)"),
  };
}

/** The commands that write a first `checks.yaml` from good recordings, and set it for a project. */
export function rulesCommands(project: string): string {
  return ["klein checks init GOOD_MISSION/ -o checks.yaml", `klein checks set checks.yaml -p ${quoted(project)}`].join("\n");
}
