// What is odd in a mission, gathered from where it is known: its metadata, its recordings, its files.
import type { File, Mission, Recording } from "@/api/types";
import { texts as fileTexts } from "@/texts/file";
import { texts } from "@/texts/mission";
import { blobTexts, contentTexts } from "@/texts/states";

interface Line {
  readonly text: string;
  readonly where: string;
}

export interface Odd {
  readonly key: string;
  readonly title: string;
  /** Whether the title is a name of somebody's, and no word of ours. */
  readonly isName: boolean;
  readonly fileId: string | null;
  readonly lines: readonly Line[];
}

const plain = (text: string): Line => ({ text, where: "" });

function ofFile(file: File): Odd {
  const lines: Line[] = [];
  if (file.state === "lost" || file.state === "corrupt") lines.push(plain(file.state_reason ?? blobTexts[file.state].why));
  if (file.content === "recovered" || file.content === "broken" || file.content === "error") {
    lines.push(plain(file.content_reason ?? contentTexts[file.content].why));
  }
  if (file.lost !== null) lines.push(plain(`${fileTexts.lost}: ${fileTexts.lostAmount(file.lost.bytes, file.lost.chunks, file.lost.messages)}`));
  lines.push(...file.problems.map((problem) => ({ text: problem.message, where: problem.where })));
  return { key: file.id, title: file.path, isName: true, fileId: file.id, lines };
}

function ofRecording(recording: Recording): Odd {
  const lines = [
    ...recording.missing.map((path) => plain(texts.missingFile(path))),
    ...recording.surplus.map((path) => plain(texts.surplusFile(path))),
    ...recording.problems.map((problem) => ({ text: problem.message, where: problem.where })),
  ];
  return { key: recording.id, title: recording.name, isName: true, fileId: null, lines };
}

/** Returns all that is odd, with nothing where nothing is. */
export function oddThings(mission: Mission | undefined, recordings: readonly Recording[], files: readonly File[]): readonly Odd[] {
  const wrong = mission?.metadata_problems ?? [];
  const ofMetadata: Odd = {
    key: "metadata", title: texts.metadataOdd, isName: false, fileId: null,
    lines: wrong.map(({ field, message }) => plain(texts.metadataProblem(field, message))),
  };
  return [ofMetadata, ...recordings.map(ofRecording), ...files.map(ofFile)].filter(({ lines }) => lines.length > 0);
}
