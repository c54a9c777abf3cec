// The files of a mission as a tree of folders, recordings and files. Pure functions, fast for ten thousand files.
import type { TimelineFile } from "./queries";
import type { ContentState, Recording } from "@/api/types";

export interface Branch {
  readonly kind: "folder" | "recording";
  readonly key: string;
  readonly name: string;
  readonly recording: Recording | null;
  readonly children: readonly Node[];
  readonly fileCount: number;
  readonly sizeBytes: number;
  readonly startNs: number | null;
  readonly endNs: number | null;
  /** The worst that is known of anything in it. */
  readonly content: ContentState;
}

export interface Leaf {
  readonly kind: "file";
  readonly key: string;
  readonly name: string;
  readonly file: TimelineFile;
}

export type Node = Branch | Leaf;

export interface TreeRow {
  readonly node: Node;
  readonly depth: number;
  readonly isOpen: boolean;
}

const WORST_FIRST: readonly ContentState[] = ["broken", "error", "recovered", "pending", "indexed", "opaque"];

interface Folder {
  readonly path: string;
  readonly name: string;
  readonly folders: Map<string, Folder>;
  readonly files: TimelineFile[];
}

/** Returns the nodes of the top; folders come before files, each by name. `files` come by path. */
export function treeOf(files: readonly TimelineFile[], recordings: readonly Recording[]): readonly Node[] {
  const byId = new Map(recordings.filter((item) => item.file_ids.length > 1).map((item) => [item.id, item]));
  return nodesOf(foldersOf(files), byId);
}

function foldersOf(files: readonly TimelineFile[]): Folder {
  const root: Folder = { path: "", name: "", folders: new Map(), files: [] };
  for (const file of files) {
    let at = root;
    const parts = file.path.split("/");
    for (const part of parts.slice(0, -1)) {
      let next = at.folders.get(part);
      if (next === undefined) {
        next = { path: `${at.path}${part}/`, name: part, folders: new Map(), files: [] };
        at.folders.set(part, next);
      }
      at = next;
    }
    at.files.push(file);
  }
  return root;
}

function nodesOf(folder: Folder, recordings: ReadonlyMap<string, Recording>): Node[] {
  const branches: Node[] = [...folder.folders.values()].map((item) => branchOf(item, recordings));
  const grouped = new Map<Recording, TimelineFile[]>();
  const leaves: Leaf[] = [];
  for (const file of folder.files) {
    const recording = file.recording_id === null ? undefined : recordings.get(file.recording_id);
    if (recording === undefined) leaves.push(leafOf(file));
    else grouped.set(recording, [...(grouped.get(recording) ?? []), file]);
  }
  for (const [recording, files] of grouped) {
    if (files.length === 1) leaves.push(...files.map(leafOf));
    else branches.push(summed("recording", `recording ${recording.id} ${folder.path}`, recording.name, recording, files.map(leafOf)));
  }
  return [...branches, ...leaves.sort((one, other) => (one.file.path < other.file.path ? -1 : 1))];
}

function leafOf(file: TimelineFile): Leaf {
  return { kind: "file", key: file.id, name: file.path.slice(file.path.lastIndexOf("/") + 1), file };
}

/** A folder that holds just one recording, and nothing else, is that recording. */
function branchOf(folder: Folder, recordings: ReadonlyMap<string, Recording>): Branch {
  const children = nodesOf(folder, recordings);
  const [only] = children;
  const isOne = children.length === 1 && only?.kind === "recording";
  return summed(
    isOne ? "recording" : "folder", `folder ${folder.path}`, folder.name, isOne ? only.recording : null, isOne ? only.children : children,
  );
}

function summed(kind: Branch["kind"], key: string, name: string, recording: Recording | null, children: readonly Node[]): Branch {
  let [fileCount, sizeBytes, worst] = [0, 0, WORST_FIRST.length - 1];
  let [startNs, endNs]: [number | null, number | null] = [null, null];
  for (const child of children) {
    const isFile = child.kind === "file";
    fileCount += isFile ? 1 : child.fileCount;
    sizeBytes += isFile ? child.file.size_bytes : child.sizeBytes;
    const [from, to] = isFile ? [child.file.start_ns, child.file.end_ns] : [child.startNs, child.endNs];
    if (from !== null && (startNs === null || from < startNs)) startNs = from;
    if (to !== null && (endNs === null || to > endNs)) endNs = to;
    worst = Math.min(worst, WORST_FIRST.indexOf(isFile ? child.file.content : child.content));
  }
  const content = recording?.content ?? WORST_FIRST[worst] ?? "opaque";
  return { kind, key, name, recording, children, fileCount, sizeBytes, startNs, endNs, content };
}

/** Returns the rows to show, those below closed branches left out. */
export function rowsOf(nodes: readonly Node[], closed: ReadonlySet<string>): TreeRow[] {
  const rows: TreeRow[] = [];
  function add(list: readonly Node[], depth: number): void {
    for (const node of list) {
      const isOpen = node.kind !== "file" && !closed.has(node.key);
      rows.push({ node, depth, isOpen });
      if (node.kind !== "file" && isOpen) add(node.children, depth + 1);
    }
  }
  add(nodes, 0);
  return rows;
}

/** Returns the keys of all branches. */
export function branchKeys(nodes: readonly Node[]): string[] {
  return nodes.flatMap((node) => (node.kind === "file" ? [] : [node.key, ...branchKeys(node.children)]));
}

/** Returns the files below a node. */
export function filesBelow(node: Node): TimelineFile[] {
  return node.kind === "file" ? [node.file] : node.children.flatMap(filesBelow);
}

/** Returns the selection after rows were toggled. A branch represents all files below it. */
export function withBranches(before: ReadonlySet<string>, after: ReadonlySet<string>, rows: readonly TreeRow[]): Set<string> {
  const result = new Set(after);
  for (const { node } of rows) {
    if (node.kind === "file" || before.has(node.key) === after.has(node.key)) continue;
    for (const file of filesBelow(node)) {
      if (after.has(node.key)) result.add(file.id);
      else result.delete(file.id);
    }
  }
  function updateBranch(node: Node): boolean {
    if (node.kind === "file") return result.has(node.key);
    const isWhole = node.children.map(updateBranch).every(Boolean);
    if (isWhole) result.add(node.key);
    else result.delete(node.key);
    return isWhole;
  }
  for (const { node, depth } of rows) if (depth === 0) updateBranch(node);
  return result;
}
