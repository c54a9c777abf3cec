// CLI and SDK commands for a mission or for selected files.
import type { TimelineFile } from "./queries";
import { quoted, type Commands } from "@/features/file/commands";
import type { Mission } from "@/api/types";

const GLOB = /[*?[\]]/;

/** Commands that fetch a mission, or of it the files that are chosen; none chosen is all. */
export function commandsOf(mission: Mission, chosen: readonly TimelineFile[]): Commands {
  const place = GLOB.test(mission.project.name + mission.name)
    ? `-m ${mission.id}`
    : `-p ${quoted(mission.project.name)} -m ${quoted(mission.name)}`;
  if (chosen.length === 0) return { cli: `klein download ${place}`, sdk: sdkOf(mission) };
  const names = chosen.map(({ path, id }) => (GLOB.test(path) || path.startsWith("-") ? id : quoted(path)));
  return { cli: `klein download ${names.join(" ")} ${place}`, sdk: sdkOfFiles(chosen) };
}

function sdkOf(mission: Mission): string {
  return [
    "import kleinkram",
    "",
    "with kleinkram.connect() as client:",
    `    mission = client.missions.get(${JSON.stringify(mission.id)})`,
    "    for recording in client.recordings.list(mission.id):",
    "        print(recording.name, recording.message_count, recording.size_bytes)",
  ].join("\n");
}

function sdkOfFiles(chosen: readonly TimelineFile[]): string {
  return [
    "import kleinkram",
    "",
    "with kleinkram.connect() as client:",
    "    for file_id in [",
    ...chosen.map(({ id }) => `        ${JSON.stringify(id)},`),
    "    ]:",
    "        file = client.files.get(file_id)",
    "        print(file.path, file.message_count, file.size_bytes)",
  ].join("\n");
}
