// The page of a share link. It requests the shared files from the JSON API. The secret of the link is the fragment of the URL
// (after the #), which browsers do not send to servers. Text from the API is never interpreted as HTML.
"use strict";

const secret = location.hash.slice(1);
const PAGE_SIZE = 200;
const PICTURES = ["png", "jpg", "jpeg", "webp", "gif"];
const OPEN_TOPICS = 30;
const MAX_PICTURE_BYTES = 20_000_000;
const VIEWED_FORMATS = ["mcap", "rosbag1", "db3", "ulog"];

function showMessage(text) {
  const message = document.getElementById("message");
  message.textContent = text;
  message.hidden = false;
}

async function request(method, path, body) {
  const response = await fetch("/api/v1" + path, {
    method,
    credentials: "omit",
    headers: { Authorization: `Bearer ${secret}`, ...(body ? { "Content-Type": "application/json" } : {}) },
    body: body && JSON.stringify(body),
  });
  const result = await response.json();
  if (!response.ok) throw new Error(response.status === 401 ? "This link has ended, or the URL is incomplete." : result.detail);
  return result;
}

function size(bytes) {
  const power = Math.min(4, Math.floor(Math.log10(Math.max(1, bytes)) / 3));
  return `${(bytes / 1000 ** power).toFixed(power && 1)} ${["B", "kB", "MB", "GB", "TB"][power]}`;
}

async function fetchFile(file) {
  const { items } = await request("POST", "/files/download", { file_ids: [file.id] });
  location.assign(items[0].url);
}

function row(file) {
  const line = document.createElement("tr");
  const [path, bytes, action] = [0, 1, 2].map(() => line.insertCell());
  const button = document.createElement("button");
  line.dataset.file = file.id;
  path.textContent = file.path;
  bytes.textContent = size(file.size_bytes);
  button.textContent = "Download";
  button.addEventListener("click", () => fetchFile(file).catch((error) => showMessage(error.message)));
  action.append(button);
  return line;
}

async function showMore(cursor) {
  const query = new URLSearchParams({ limit: PAGE_SIZE, ...(cursor ? { cursor } : {}) });
  const page = await request("GET", `/files?${query}`);
  document.getElementById("files").append(...page.items.map(row));
  showThumbnails(page.items).catch(() => undefined); // the list is complete without pictures
  const more = document.getElementById("more");
  more.hidden = page.next === null;
  more.onclick = () => showMore(page.next).catch((error) => showMessage(error.message));
}

// A picture of a camera beside each recording that has one.
async function showThumbnails(files) {
  const recordings = files.filter(({ content }) => content === "indexed" || content === "recovered");
  if (recordings.length === 0) return;
  const { items } = await request("POST", "/files/thumbnails", { file_ids: recordings.map(({ id }) => id) });
  for (const { file_id: id, jpeg } of items) {
    const bytes = Uint8Array.from(atob(jpeg), (letter) => letter.charCodeAt(0));
    const picture = document.createElement("img");
    picture.src = URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" }));
    picture.onload = () => URL.revokeObjectURL(picture.src);
    picture.alt = "Picture of a camera";
    document.querySelector(`[data-file="${CSS.escape(id)}"] td`)?.prepend(picture);
  }
}

function element(name, text) {
  const created = document.createElement(name);
  created.textContent = text;
  return created;
}

function asText(value) {
  if (typeof value === "boolean") return value ? "Yes" : "No";
  if (value === null || typeof value !== "object") return String(value);
  if (Array.isArray(value)) return value.map(asText).join(", ");
  return value.name || (typeof value.latitude === "number" ? `${value.latitude}, ${value.longitude}` : JSON.stringify(value));
}

function span(nanoseconds) {
  const hours = nanoseconds / 3.6e12;
  if (hours >= 8766) return `${(hours / 8766).toFixed(1)} years`;
  if (hours >= 100) return `${(hours / 24).toFixed(1)} days`;
  if (hours >= 1) return `${Math.floor(hours)} h ${String(Math.floor((hours % 1) * 60)).padStart(2, "0")} min`;
  const minutes = Math.floor(hours * 60);
  if (minutes >= 1) return `${minutes} min ${String(Math.floor((nanoseconds / 1e9) % 60)).padStart(2, "0")} s`;
  return `${(nanoseconds / 1e9).toFixed(1)} s`;
}

// The verdict with the checks that failed, such as "bad: 2 errors, 1 accepted".
function verdictText({ verdict, checks }) {
  const numbers = [[checks.error, "error"], [checks.warning, "warning"]].map(([count, noun]) => [count, count === 1 ? noun : `${noun}s`]);
  const counted = [...numbers, [checks.not_made, "not made"], [checks.accepted, "accepted"]].filter(([count]) => count > 0);
  return [verdict, counted.map(([count, what]) => `${count.toLocaleString("en-GB")} ${what}`).join(", ")].filter((text) => text !== "").join(": ");
}

// Metadata, notes, the recording time, and the verdict. A link to single files shows none of these.
function showAbout(mission) {
  const facts = Object.entries(mission.metadata).map(([name, value]) => [name, asText(value)]);
  if (mission.start_ns !== null) {
    const began = new Date(mission.start_ns / 1e6).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" });
    facts.unshift(["Recorded", `${began}, ${span(mission.end_ns - mission.start_ns)}`]);
  }
  if (mission.verdict !== "unchecked") facts.push(["Checks", verdictText(mission)]);
  if (mission.notes !== "") facts.push(["Notes", mission.notes]);
  document.getElementById("metadata").append(...facts.flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
  if (facts.length > 0) document.getElementById("about").hidden = false;
}

async function showTopics(missionId) {
  const { items, next } = await request("GET", `/missions/${missionId}/topics?limit=500`);
  if (items.length === 0) return;
  const box = document.getElementById("topics");
  box.querySelector("summary").textContent = `${items.length}${next ? " or more" : ""} ${items.length === 1 ? "topic" : "topics"}`;
  for (const topic of items) {
    const line = box.querySelector("tbody").insertRow();
    for (const text of [topic.name, topic.message_type ?? "", topic.count?.toLocaleString("en-GB") ?? ""]) line.insertCell().textContent = text;
  }
  box.open = items.length <= OPEN_TOPICS;
  box.hidden = false;
}

// The first image among the files, such as a preview that an action added to the mission.
async function showPicture() {
  const query = new URLSearchParams([["limit", "1"], ["max_size_bytes", MAX_PICTURE_BYTES], ...PICTURES.map((ending) => ["path", `*.${ending}`])]);
  const [file] = (await request("GET", `/files?${query}`)).items;
  if (file === undefined) return;
  const { items } = await request("POST", "/files/download", { file_ids: [file.id], purpose: "preview" });
  const picture = document.getElementById("picture");
  picture.src = items[0].url;
  picture.alt = file.path;
  picture.hidden = false;
  document.getElementById("about").hidden = false;
}

// The viewer gets the secret in the fragment, too.
async function offerViewer() {
  const readable = [...VIEWED_FORMATS.map((format) => ["format", format]), ["content", "indexed"], ["content", "recovered"]];
  if ((await request("GET", `/files?${new URLSearchParams([["limit", "1"], ...readable])}`)).items.length === 0) return;
  const link = document.getElementById("view");
  link.href = `/s/view#${secret}`;
  link.hidden = false;
}

async function allFiles() {
  const files = [];
  for (let cursor = null, isMore = true; isMore; isMore = cursor !== null) {
    const page = await request("GET", `/files?${new URLSearchParams({ limit: 500, ...(cursor ? { cursor } : {}) })}`);
    files.push(...page.items);
    cursor = page.next;
  }
  return files;
}

// The folders and the name of a file, without characters that some systems do not allow.
function placeOf(file) {
  return file.path.split("/").map((part) => part.replaceAll(/[<>:"\\|?*\u0000-\u001f]/g, "_"));
}

// Writes one file below a folder. A file with that name and size counts as downloaded.
async function saveFile(root, file) {
  const parts = placeOf(file);
  let folder = root;
  for (const part of parts.slice(0, -1)) folder = await folder.getDirectoryHandle(part, { create: true });
  const handle = await folder.getFileHandle(parts.at(-1), { create: true });
  const existingBytes = (await handle.getFile()).size;
  if (existingBytes === file.size_bytes) return;
  if (existingBytes > 0) throw new Error("the folder contains another file with this name");
  try {
    const { items } = await request("POST", "/files/download", { file_ids: [file.id] });
    const response = await fetch(items[0].url, { credentials: "omit" });
    if (!response.ok) throw new Error(`the store returned status ${response.status}`);
    await response.body.pipeTo(await handle.createWritable()); // the file stays empty until all bytes have arrived
    if ((await handle.getFile()).size !== file.size_bytes) throw new Error("the download is incomplete");
  } catch (error) {
    await folder.removeEntry(parts.at(-1)).catch(() => undefined); // an incomplete file must not keep the name
    throw error;
  }
}

async function saveAll() {
  const root = await window.showDirectoryPicker({ mode: "readwrite" });
  const [progress, failures] = [document.getElementById("progress"), []];
  const files = await allFiles();
  const taken = new Set();
  for (const [at, file] of files.entries()) {
    progress.textContent = `${at} of ${files.length} files`;
    const name = placeOf(file).join("/").normalize().toLowerCase(); // as Windows and macOS compare names
    if (taken.has(name)) {
      failures.push(`${file.path}: another file has the same name on this computer`);
      continue;
    }
    taken.add(name);
    await saveFile(root, file).catch((error) => failures.push(`${file.path}: ${error.message}`));
  }
  progress.textContent = `${files.length - failures.length} of ${files.length} files downloaded.${failures.length ? ` Failed: ${failures.join("; ")}` : ""}`;
}

function offerAll(bytes) {
  const button = document.getElementById("download");
  const canWrite = "showDirectoryPicker" in window;
  button.textContent = `Download all (${size(bytes)})…`;
  button.hidden = !canWrite;
  button.addEventListener("click", () => {
    button.disabled = true;
    saveAll().catch((error) => error.name === "AbortError" || showMessage(error.message)).finally(() => (button.disabled = false));
  });
  if (!canWrite) document.getElementById("progress").textContent = "This browser cannot write to a folder. Download the files one by one, or all of them with the command.";
  document.getElementById("command").textContent = `klein download '${location.href}'`;
  document.getElementById("all").hidden = false;
}

async function show() {
  const shown = await request("GET", "/share");
  const what = `${shown.file_count} ${shown.file_count === 1 ? "file" : "files"}, ${size(shown.size_bytes)}`;
  document.querySelector("h1").textContent = `${shown.mission.project.name} / ${shown.mission.name}`;
  document.getElementById("what").textContent = `${what}; until ${new Date(shown.expires_at).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" })}.`;
  offerAll(shown.size_bytes);
  await showMore(null);
  const more = [request("GET", `/missions/${shown.mission.id}`).then(showAbout), showTopics(shown.mission.id), showPicture(), offerViewer()];
  for (const { reason } of await Promise.allSettled(more)) if (reason) showMessage(reason.message);
}

show().catch((error) => showMessage(error.message));
