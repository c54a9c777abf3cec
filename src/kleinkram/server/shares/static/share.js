// What the page of a link does: ask the JSON API what the link shows, and where its files are. The link's secret is the
// part of the address behind the #, which browsers send nowhere; no text from elsewhere becomes HTML.
"use strict";

const secret = location.hash.slice(1);
const AT_ONCE = 200;

function say(text) {
  const said = document.getElementById("said");
  said.textContent = text;
  said.hidden = false;
}

async function ask(method, path, body) {
  const answer = await fetch("/api/v1" + path, {
    method,
    credentials: "omit",
    headers: { Authorization: `Bearer ${secret}`, ...(body ? { "Content-Type": "application/json" } : {}) },
    body: body && JSON.stringify(body),
  });
  const told = await answer.json();
  if (!answer.ok) throw new Error(answer.status === 401 ? "This link has ended, or was not copied whole." : told.detail);
  return told;
}

function size(bytes) {
  const power = Math.min(4, Math.floor(Math.log10(Math.max(1, bytes)) / 3));
  return `${(bytes / 1000 ** power).toFixed(power && 1)} ${["B", "kB", "MB", "GB", "TB"][power]}`;
}

async function fetchFile(file) {
  const { items } = await ask("POST", "/files/download", { file_ids: [file.id] });
  location.assign(items[0].url);
}

function row(file) {
  const line = document.createElement("tr");
  const [path, bytes, action] = [0, 1, 2].map(() => line.insertCell());
  const button = document.createElement("button");
  path.textContent = file.path;
  bytes.textContent = size(file.size_bytes);
  button.textContent = "Download";
  button.addEventListener("click", () => fetchFile(file).catch((error) => say(error.message)));
  action.append(button);
  return line;
}

async function showMore(cursor) {
  const query = new URLSearchParams({ limit: AT_ONCE, ...(cursor ? { cursor } : {}) });
  const page = await ask("GET", `/files?${query}`);
  document.getElementById("files").append(...page.items.map(row));
  const more = document.getElementById("more");
  more.hidden = page.next === null;
  more.onclick = () => showMore(page.next).catch((error) => say(error.message));
}

async function show() {
  const shown = await ask("GET", "/share");
  const what = `${shown.file_count} ${shown.file_count === 1 ? "file" : "files"}, ${size(shown.size_bytes)}`;
  document.querySelector("h1").textContent = `${shown.mission.project.name} / ${shown.mission.name}`;
  document.getElementById("what").textContent = `${what}; until ${new Date(shown.expires_at).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" })}.`;
  await showMore(null);
}

show().catch((error) => say(error.message));
