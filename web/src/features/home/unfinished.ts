// Unfinished uploads come file by file; somebody goes on with a whole mission.
import type { UnfinishedUpload } from "./queries";

export interface UnfinishedMission {
  readonly mission: UnfinishedUpload["mission"];
  readonly files: readonly UnfinishedUpload[];
  readonly sizeBytes: number;
  /** Null where the store did not say it of any of them. */
  readonly sentBytes: number | null;
  readonly expiresAt: string;
}

/** Returns unfinished uploads by mission, in the order of their first. */
export function byMission(uploads: readonly UnfinishedUpload[]): readonly UnfinishedMission[] {
  const groups = new Map<string, UnfinishedUpload[]>();
  for (const upload of uploads) groups.set(upload.mission.id, [...(groups.get(upload.mission.id) ?? []), upload]);
  return [...groups.values()].flatMap((files) => {
    const [first] = files;
    return first === undefined ? [] : [summed(first.mission, files)];
  });
}

function summed(mission: UnfinishedUpload["mission"], files: readonly UnfinishedUpload[]): UnfinishedMission {
  const told = files.flatMap(({ sent_bytes: sent }) => (sent === null ? [] : [sent]));
  return {
    mission,
    files,
    sizeBytes: files.reduce((sum, file) => sum + file.size_bytes, 0),
    sentBytes: told.length === 0 ? null : told.reduce((sum, sent) => sum + sent, 0),
    expiresAt: files.reduce((first, file) => (file.expires_at < first ? file.expires_at : first), files[0]?.expires_at ?? ""),
  };
}
