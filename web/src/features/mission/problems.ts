// The problems of a mission, gathered from where they are known: its metadata, its recordings, its files.
import type { File, Mission, Recording } from "@/api/types";
import type { Problem } from "@/components/problems";
import { problemsOfFile } from "@/features/file/problems";
import { texts } from "@/texts/mission";

function ofRecording(recording: Recording): Problem[] {
  const place = { source: recording.name, fileId: null };
  return [
    ...recording.missing.map((path) => ({ code: "member-missing", message: texts.missingFile(path), where: "", ...place })),
    ...recording.surplus.map((path) => ({ code: "member-surplus", message: texts.surplusFile(path), where: "", ...place })),
    ...recording.problems.map(({ code, message, where }) => ({ code, message, where, ...place })),
  ];
}

/** Returns all problems of a mission. */
export function problemsOfMission(mission: Mission | undefined, recordings: readonly Recording[], files: readonly File[]): readonly Problem[] {
  const ofMetadata = (mission?.metadata_problems ?? []).map(({ field, message }) => (
    { code: "metadata", message: texts.metadataProblem(field, message), where: "", source: "", fileId: null }
  ));
  return [...ofMetadata, ...recordings.flatMap(ofRecording), ...files.flatMap(problemsOfFile)];
}
