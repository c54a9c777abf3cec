// The words of uploading: the page, what is left out and why, how files end, and what to do.
import type { Phase } from "@/features/upload/engine/desk";
import type { FileState, LeftOutReason, LocalFailure, Trouble } from "@/features/upload/engine/nouns";
import type { PathProblem } from "@/features/upload/engine/paths";
import { counted, formatShare, formatSize, formatSpeed } from "@/components/format";

export const pathProblem: Readonly<Record<PathProblem["problem"], (detail: string) => string>> = {
  control: (code) => `its name holds the control character ${code}; rename it`,
  not_relative: () => "it has no name below a folder",
  backslash: () => "its name holds a backslash, which other systems read as a folder; rename it",
  too_long: (count) => `its path has ${count} characters; 1,024 are allowed`,
  too_many_bytes: (count) => `its path has ${count} bytes; 2,400 are allowed`,
  part: (part) => `its path holds the part “${part}”, which would leave or blur its place`,
  long_part: (count) => `a part of its path has ${count} bytes; 255 are allowed`,
};

const leftOut: Readonly<Record<LeftOutReason, (detail: string) => string>> = {
  active: () => "it is still being recorded: its name ends in .active",
  growing: () => "something is writing to it; choose it again when that has ended",
  unreadable: () => "the browser could not read it",
  name: (detail) => detail,
  too_large: () => "it is larger than the 5 TiB that a store takes",
  collides: (other) => `it would have the same path in the mission as ${other}`,
};

const failures: Readonly<Record<LocalFailure, (detail: string) => string>> = {
  file_changed: () => "It was written to, moved or deleted after you chose it. Choose it again once nothing writes to it.",
  file_unreadable: () => "The disk does not give its bytes. Look at the disk or its cable, then try again.",
  transfer_failed: (detail) => `The store would not take it (${detail}). Try again; if it stays, tell an admin.`,
  worker_ended: () => "The part of this page that uploads has ended. Reload the page, then choose the folder again.",
};

/** What the server's failures mean for somebody who uploads. */
const refusals: Readonly<Partial<Record<string, string>>> = {
  file_exists: "A file of this name with other content is in the mission already. Nothing was changed. Rename yours, or delete the one that is there, then upload again.",
  path_conflict: "It cannot stand beside another file there: one is a file where the other needs a folder, or their names differ only in case. Rename one of them.",
  name_leased: "Somebody else is uploading a file of this name right now. Wait until that has ended, then try again.",
  quota_exceeded: "The project has no room for it. Delete something, or ask an admin for more room.",
  upload_gone: "Its upload ended several times while it was on its way. Try again.",
  upload_incomplete: "The store does not hold all of it. Try again; only what is missing is sent.",
  checksum_mismatch: "The bytes that arrived are not those that were read. Nothing was kept. Try again; if it stays, look at the disk and the network.",
};

const states: Readonly<Record<FileState, string>> = {
  waiting: "waiting",
  reading: "reading",
  sending: "sending",
  uploaded: "uploaded",
  present: "already there",
  linked: "linked",
  refused: "not uploaded",
  left: "not begun",
};

const phases: Readonly<Record<Phase, string>> = {
  running: "uploading",
  paused: "paused",
  signed_out: "signed out",
  elsewhere: "in another tab",
  failed: "stopped",
  cancelled: "cancelled",
  over: "done",
};

const troubles: Readonly<Record<Trouble | "both", string>> = {
  both: "The network is away, or the server is; this goes on by itself as soon as it is back.",
  server: "The server does not answer; this goes on by itself as soon as it does.",
  store: "The store of the bytes does not answer, or the network is away; this goes on by itself as soon as it can.",
  lease: "Some names are held by an upload that may have died; that ends within a minute.",
};

function timeLeft(seconds: number): string {
  if (seconds < 60) return `${Math.max(1, Math.round(seconds))} s left`;
  const minutes = Math.round(seconds / 60);
  return minutes < 60 ? `${minutes} min left` : `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min left`;
}

export const texts = {
  title: "Upload",
  lead: "Recordings go straight from this browser to the store, checked on the way. Close the lid, lose the network: it goes on where it was.",
  pathProblem,
  leftOut,
  failures,
  refusals,
  states,
  phases,
  troubles,
  stateWhy: {
    present: "The mission had this very file already; nothing was sent.",
    linked: "The server had these bytes already; nothing was sent.",
  } as Readonly<Partial<Record<FileState, string>>>,
  drop: {
    title: "Drop a folder or files here",
    titleOnPhone: "Choose the files to upload",
    hint: "A folder keeps its tree, so the files of one recording stay together.",
    folder: "Choose a folder",
    files: "Choose files",
    looking: (count: number) => (count === 0 ? "Looking through it" : `Looking through it: ${counted(count, "file")} so far`),
    nothing: "There is no file in what you chose. Folders without files are nothing to upload.",
  },
  plan: {
    title: "What is uploaded",
    summary: (count: number, bytes: number) => `${counted(count, "file")}, ${formatSize(bytes)}`,
    rosbag2: (count: number) => `${counted(count, "rosbag2 folder")} kept together`,
    leftOut: (count: number) => `${counted(count, "file is", "files are")} left out`,
    more: (count: number) => `and ${counted(count, "more", "more")}`,
    layout: "Paths in the mission",
    tree: "With the folder’s name",
    contents: "Without it",
    remove: "Choose something else",
    example: (path: string) => `for example ${path}`,
  },
  place: {
    title: "Where it goes",
    project: "Project",
    chooseProject: "Choose a project",
    newProject: "A new project",
    projectName: "Name of the new project",
    noProjects: "You may not upload into any project yet. Make one, or ask somebody for access to theirs.",
    mission: "Mission",
    fresh: "A new mission",
    chooseMission: "Choose a mission",
    missionName: "Name of the new mission",
    missionHint: "One outing of a robot, for example 2026-11-21-forest-2",
    find: "Find by name",
    start: (count: number) => `Upload ${counted(count, "file")}`,
    needsName: "Give it a name.",
    needsChoice: "Choose one.",
  },
  run: {
    into: (mission: string, project: string) => `${mission} in ${project}`,
    progress: (done: number, total: number) => `${formatSize(done)} of ${formatSize(total)}`,
    share: formatShare,
    rate: (bytesPerS: number) => formatSpeed(bytesPerS),
    timeLeft,
    pause: "Pause",
    goOn: "Continue",
    cancel: "Cancel",
    retry: "Try again",
    dismiss: "Close",
    open: "Open the mission",
    further: (count: number) => `${counted(count, "more file")} will follow.`,
    signedOut: "Your session has ended. Sign in again and it goes on.",
    elsewhere: "Another tab of this browser is uploading into this mission. Add these files there, or try again when it is done.",
    incomplete: "incomplete",
    failed: "It stopped; what was sent is kept.",
    over: (count: number) => `All ${counted(count, "file")} are there.`,
    overOne: "The file is there.",
    partly: (refused: number, count: number) => `${refused} of ${counted(count, "file")} did not come in; why is said beside each.`,
    cancelled: (count: number) => `Cancelled. ${counted(count, "file")} came in before.`,
    closing: "You may look at other pages meanwhile; keep this tab open.",
    files: "Files of this upload",
    file: "File",
    size: "Size",
    state: "State",
    sent: "Sent",
    read: (share: string) => `${share} read`,
    count: (state: string, count: number) => `${count} ${state}`,
    reason: "Why it was not uploaded",
    hashThere: "There",
    hashYours: "Yours",
    openFile: "Open the file that is there",
    cancelTitle: "Cancel this upload?",
    cancelText: "Files that have come in stay in the mission. The rest is forgotten, here and in the store.",
    cancelConfirm: "Cancel the upload",
  },
  unfinished: {
    title: "Unfinished",
    left: (count: number, bytes: number) => `${counted(count, "file")} left, ${formatSize(bytes)}`,
    held: (bytes: number) => `of which about ${formatSize(bytes)} are at the store already`,
    done: (count: number) => `${counted(count, "file")} came in before`,
    matches: (mission: string) => `This looks like the upload into ${mission} that is unfinished.`,
    goOnThere: "Continue that one",
    again: (roots: string) => `Choose ${roots} again and it goes on: what the store holds is not sent twice.`,
    forget: "Forget it",
    forgetTitle: "Forget this upload?",
    forgetText: "Files that have come in stay in the mission. The rest is forgotten, here and in the store.",
    fit: (same: number, changed: number, missing: number) =>
      [
        `${counted(same, "file")} as before`,
        changed > 0 ? `${counted(changed, "file")} changed since: what differs is sent anew` : "",
        missing > 0 ? `${counted(missing, "file")} missing in what you chose` : "",
      ].filter(Boolean).join(" · "),
    elsewhere: "Another tab of this browser is uploading it.",
    noneFits: "None of the unfinished files is in what you chose. Choose the same folder as before.",
    missing: "Not found in what you chose",
    goOn: "Continue",
    notKept: "This browser keeps nothing for this page (a private window?). Uploads work, but after a reload they begin anew.",
  },
  indicator: (share: string) => `Uploading, ${share}`,
  indicatorPaused: "Upload paused",
  indicatorTrouble: "Upload waits",
} as const;
