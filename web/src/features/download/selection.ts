// What is downloaded (files, whole missions, or search results), the path of each file, and the equivalent command.
import { safePath, type Source, type Target } from "./save";
import { api, call } from "@/api/client";
import type { operations } from "@/api/schema";
import type { Mission } from "@/api/types";
import { fileArguments, missionArguments, quoted } from "@/components/commands";

export interface ChosenFile {
  readonly id: string;
  readonly path: string;
  readonly size_bytes: number;
  readonly mission: { readonly id: string; readonly name: string; readonly project: { readonly name: string } };
}

export type Selection =
  | { readonly kind: "files"; readonly files: readonly ChosenFile[] }
  | { readonly kind: "missions"; readonly missions: readonly Mission[] }
  | { readonly kind: "query"; readonly query: string };

const PAGE = 500;
/** More files than these at once are for the command line. */
export const MAX_FILES = 20_000;

function missionsOf(selection: Exclude<Selection, { kind: "query" }>): readonly ChosenFile["mission"][] {
  const all = selection.kind === "missions" ? selection.missions : selection.files.map(({ mission }) => mission);
  return [...new Map(all.map((mission) => [mission.id, mission])).values()];
}

/** Returns whether files go below folders of their project and mission: those of several missions may have one path. */
export function isNested(selection: Selection): boolean {
  return selection.kind === "query" || missionsOf(selection).length > 1;
}

/** Returns the command that downloads a selection; of several missions one a line. */
export function commandOf(selection: Selection): string {
  if (selection.kind === "query") return `klein download --nested --query ${quoted(selection.query)} --dest data`;
  const nested = isNested(selection) ? "--nested --dest data " : "";
  return missionsOf(selection)
    .map((mission) => {
      const files = selection.kind === "files" ? selection.files.filter((file) => file.mission.id === mission.id) : [];
      return `klein download ${nested}${[...fileArguments(files), missionArguments(mission)].join(" ")}`;
    })
    .join("\n");
}

/** Returns where each file of a selection goes. */
export function targetsOf(files: readonly ChosenFile[], nested: boolean): readonly Target[] {
  return files.map(({ id, path, size_bytes: sizeBytes, mission }) => {
    const place = nested ? [mission.project.name, mission.name].flatMap((name) => safePath(name.replaceAll("/", "_"))) : [];
    return { fileId: id, path: [...place, ...safePath(path)], sizeBytes };
  });
}

type FileQuery = NonNullable<operations["list_files"]["parameters"]["query"]>;

/** Returns the files of a selection, at most one more than `MAX_FILES`. */
export async function filesOf(selection: Selection, signal: AbortSignal): Promise<readonly ChosenFile[]> {
  if (selection.kind === "files") return selection.files;
  const queries: FileQuery[] = selection.kind === "query" ? [{ query: selection.query }] : selection.missions.map(({ id }) => ({ mission_id: id }));
  const files: ChosenFile[] = [];
  for (const query of queries) {
    for (let cursor: string | null = ""; cursor !== null && files.length <= MAX_FILES; ) {
      const pageQuery: FileQuery = { ...query, sort: "path", limit: PAGE, ...(cursor !== "" && { cursor }) };
      const page = await call(api.GET("/api/v1/files", { params: { query: pageQuery }, signal }));
      files.push(...page.items);
      cursor = page.next ?? null;
    }
  }
  return files;
}

/** The store, by addresses that the server signs one by one, when a file is about to be fetched. */
export const store: Source = {
  linkOf: async ({ fileId }, signal) => {
    const { items: [link] } = await call(api.POST("/api/v1/files/download", { body: { file_ids: [fileId], purpose: "download" }, signal }));
    if (link === undefined) throw new Error("The server gave no address for this file.");
    // Unverified bytes are compared with the uploader's checksum.
    return { url: link.url, sha256: link.sha256 };
  },
  fetch: (input, init) => globalThis.fetch(input, init),
};
