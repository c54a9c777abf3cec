// Texts of the upload page.
import type { Phase } from "@/features/upload/engine/uploadQueue";
import type { FileState, LeftOutReason, LocalFailure, WaitReason } from "@/features/upload/engine/types";
import type { PathProblem } from "@/features/upload/engine/plan";
import { counted, formatShare, formatSize, formatSpeed } from "@/components/format";

export const pathProblem: Readonly<Record<PathProblem["problem"], (detail: string) => string>> = {
  control: (code) => `the name contains the control character ${code}; rename the file`,
  not_relative: () => "the path is not relative",
  backslash: () => "the name contains a backslash; rename the file",
  too_long: (count) => `the path has ${count} characters; the limit is 1,024`,
  too_many_bytes: (count) => `the path has ${count} bytes; the limit is 2,400`,
  part: (part) => `the path contains “${part}”, which is not allowed`,
  long_part: (count) => `a part of the path has ${count} bytes; the limit is 255`,
};

const leftOut: Readonly<Record<LeftOutReason, (detail: string) => string>> = {
  active: () => "the file is still being recorded (.active)",
  growing: () => "another program is writing to the file; select it again later",
  unreadable: () => "the browser cannot read the file",
  name: (detail) => detail,
  too_large: () => "the file exceeds the store limit of 5 TiB",
  collides: (other) => `the path conflicts with ${other}`,
};

const failures: Readonly<Record<LocalFailure, (detail: string) => string>> = {
  file_changed: () => "The file was changed, moved, or deleted after you selected it. Select it again.",
  file_unreadable: () => "The file cannot be read. Check the disk and try again.",
  transfer_failed: (detail) => `The store rejected the file (${detail}). Try again. If the problem persists, contact an admin.`,
  worker_ended: () => "The upload process stopped. Reload the page and choose the folder again.",
};

/** Errors of the server in the context of an upload. */
const refusals: Readonly<Partial<Record<string, string>>> = {
  file_exists: "The mission already has a file with this path and different content. Rename your file or delete the existing one, then upload again.",
  path_conflict: "The path conflicts with another file: one is a file and the other a folder, or they differ only in case. Rename one of them.",
  name_leased: "Someone else is uploading a file with this path. Try again when that upload is done.",
  quota_exceeded: "The project quota is used up. Delete files, or ask an admin for a higher quota.",
  upload_gone: "The upload expired several times. Try again.",
  upload_incomplete: "The upload is incomplete. Try again; only missing data is sent.",
  checksum_mismatch: "The checksum does not match, so the file was not stored. Try again. If the problem persists, check the disk and the network.",
};

const states: Readonly<Record<FileState, string>> = {
  waiting: "waiting",
  reading: "reading",
  sending: "sending",
  uploaded: "uploaded",
  already_present: "already there",
  deduplicated: "deduplicated",
  refused: "not uploaded",
  left: "not started",
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

const waitReasons: Readonly<Record<WaitReason | "both", string>> = {
  both: "No connection to the server. The upload continues automatically.",
  server: "The server does not respond. The upload continues automatically.",
  store: "The object store does not respond. The upload continues automatically.",
  lease: "Some paths are reserved by another upload, which may have stopped. The upload continues within a minute.",
};

function timeLeft(seconds: number): string {
  if (seconds < 60) return `${Math.max(1, Math.round(seconds))} s left`;
  const minutes = Math.round(seconds / 60);
  return minutes < 60 ? `${minutes} min left` : `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min left`;
}

export const texts = {
  title: "Upload",
  lead: "Files go directly from your browser to the store and are verified. Interrupted uploads resume where they stopped.",
  pathProblem,
  leftOut,
  failures,
  refusals,
  states,
  phases,
  waitReasons,
  stateWhy: {
    already_present: "The mission already had this file; nothing was sent.",
    deduplicated: "The server already had this content; nothing was sent.",
  } as Readonly<Partial<Record<FileState, string>>>,
  drop: {
    title: "Drop a folder or files here",
    titleOnPhone: "Choose the files to upload",
    hint: "Folders keep their structure, so the files of a recording stay together.",
    folder: "Choose a folder",
    files: "Choose files",
    looking: (count: number) => (count === 0 ? "Scanning" : `Scanning: ${counted(count, "file")} so far`),
    nothing: "Your selection contains no files.",
  },
  plan: {
    title: "Files to upload",
    summary: (count: number, bytes: number) => `${counted(count, "file")}, ${formatSize(bytes)}`,
    rosbag2: (count: number) => `${counted(count, "rosbag2 folder")} kept together`,
    leftOut: (count: number) => `${counted(count, "file", "files")} skipped`,
    more: (count: number) => `and ${counted(count, "more", "more")}`,
    layout: "Paths in the mission",
    tree: "Include the folder name",
    contents: "Contents only",
    remove: "Change selection",
    example: (path: string) => `for example ${path}`,
  },
  place: {
    title: "Destination",
    project: "Project",
    chooseProject: "Choose a project",
    newProject: "New project",
    projectName: "Project name",
    noProjects: "You cannot upload to any project yet. Create one, or ask for access to one.",
    mission: "Mission",
    fresh: "New mission",
    chooseMission: "Choose a mission",
    missionName: "Mission name",
    missionHint: "One outing of a robot, for example 2026-11-21-forest-2",
    find: "Find by name",
    start: (count: number) => `Upload ${counted(count, "file")}`,
    needsName: "Enter a name.",
    needsChoice: "Select one.",
  },
  run: {
    into: (mission: string, project: string) => `${mission} in ${project}`,
    progress: (done: number, total: number) => `${formatSize(done)} of ${formatSize(total)}`,
    share: formatShare,
    rate: (bytesPerS: number) => formatSpeed(bytesPerS),
    timeLeft,
    pause: "Pause",
    resume: "Continue",
    cancel: "Cancel",
    retry: "Try again",
    dismiss: "Close",
    open: "Open the mission",
    further: (count: number) => `${counted(count, "more file")} to follow.`,
    signedOut: "Your session has ended. Sign in again to continue.",
    elsewhere: "Another tab is uploading to this mission. Add the files there, or try again when it is done.",
    incomplete: "incomplete",
    failed: "The upload stopped. Data that was sent is kept.",
    over: (count: number) => `All ${counted(count, "file")} uploaded.`,
    overOne: "File uploaded.",
    partly: (refused: number, count: number) => `${refused} of ${counted(count, "file")} not uploaded. See the reason for each file.`,
    cancelled: (count: number) => `Cancelled. ${counted(count, "file")} uploaded.`,
    closing: "You can use other pages. Keep this tab open.",
    files: "Files of this upload",
    file: "File",
    size: "Size",
    state: "State",
    sent: "Sent",
    read: (share: string) => `${share} read`,
    count: (state: string, count: number) => `${count} ${state}`,
    reason: "Reason",
    hashExisting: "Existing file",
    hashYours: "Your file",
    openFile: "Open existing file",
    cancelTitle: "Cancel this upload?",
    cancelText: "Uploaded files stay in the mission. Partial data of all other files is deleted.",
    cancelConfirm: "Cancel upload",
  },
  unfinished: {
    title: "Unfinished uploads",
    left: (count: number, bytes: number) => `${counted(count, "file")} left, ${formatSize(bytes)}`,
    stored: (bytes: number) => `of which about ${formatSize(bytes)} are already in the store`,
    done: (count: number) => `${counted(count, "file")} uploaded`,
    matches: (mission: string) => `This looks like your unfinished upload to ${mission}.`,
    resumeMatch: "Resume that upload",
    again: (roots: string) => `To resume, choose ${roots} again. Data that is already in the store is not sent again.`,
    discard: "Discard",
    discardTitle: "Discard this upload?",
    discardText: "Uploaded files stay in the mission. Partial data of all other files is deleted.",
    fit: (same: number, changed: number, missing: number) =>
      [
        `${counted(same, "file")} unchanged`,
        changed > 0 ? `${counted(changed, "file")} changed, will be sent again` : "",
        missing > 0 ? `${counted(missing, "file")} missing from your selection` : "",
      ].filter(Boolean).join(" · "),
    elsewhere: "Another tab is uploading it.",
    noneFits: "Your selection contains none of the unfinished files. Choose the same folder as before.",
    missing: "Not in your selection",
    resume: "Resume",
    notPersistent: "This browser does not store data for this page (private window?). Uploads work, but they cannot resume after a reload.",
  },
  indicator: (share: string) => `Uploading, ${share}`,
  indicatorPaused: "Upload paused",
  indicatorWaiting: "Upload waiting",
} as const;
