// The problems of one file: of its bytes, of its content, and inside its recording.
import type { File } from "@/api/types";
import type { Problem } from "@/components/problems";
import { texts } from "@/texts/file";
import { blobTexts, contentTexts } from "@/texts/states";

/** Returns all problems of a file. */
export function problemsOfFile(file: File): readonly Problem[] {
  const problems: Problem[] = [];
  const add = (code: string, message: string, where = "") => problems.push({ code, message, where, source: file.path, fileId: file.id });
  if (file.state === "lost" || file.state === "corrupt") add(`bytes-${file.state}`, file.state_reason ?? blobTexts[file.state].why);
  if (file.content === "broken" || file.content === "error") add("unreadable", file.content_reason ?? contentTexts[file.content].why);
  if (file.content === "recovered") add("recovered", file.content_reason ?? contentTexts.recovered.why);
  if (file.lost !== null) add("data-lost", texts.lostAmount(file.lost.bytes, file.lost.chunks, file.lost.messages));
  for (const { code, message, where } of file.problems) add(code, message, where);
  return problems;
}
