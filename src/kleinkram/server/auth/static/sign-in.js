// What the pages of signing in do: ask the JSON API, say its sentences, go where it says. No code is ever evaluated,
// and no text from elsewhere becomes HTML.
"use strict";

const page = document.body.dataset.page;
const asked = new URLSearchParams(location.search);
const code = location.hash.slice(1);

function say(text) {
  const said = document.getElementById("said");
  said.textContent = text;
  said.hidden = false;
}

// Only to a path of this server: never to another one, however it is written.
function home() {
  const wanted = asked.get("return_to") || "/";
  return /^\/($|[^/\\])/.test(wanted) && new URL(wanted, location.origin).origin === location.origin ? wanted : "/";
}

function here() {
  return location.pathname + location.search;
}

async function ask(method, path, body) {
  const answer = await fetch("/api/v1" + path, {
    method,
    headers: body === undefined ? {} : { "Content-Type": "application/json" },
    body: body === undefined ? undefined : JSON.stringify(body),
  });
  const told = answer.status === 204 ? null : await answer.json();
  if (!answer.ok) throw Object.assign(new Error(told.detail), { status: answer.status, code: told.code });
  return told;
}

// Whoever is signed in, but too long ago, proves once more who they are, in this very session.
const isAgain = asked.has("again");

function signInAgain() {
  location.replace("/sign-in?" + new URLSearchParams({ return_to: here(), again: "1" }));
}

function askForSecondFactor() {
  const field = document.getElementById("second-factor");
  field.hidden = false;
  field.querySelector("input").focus();
}

// What is empty is not sent: an account without a second factor has no code.
function filled(given) {
  return Object.fromEntries(Object.entries(given).filter(([name, value]) => name !== "second_factor" || value));
}

function letPress(may) {
  document.querySelectorAll("button").forEach((button) => (button.disabled = !may));
}

async function attempt(work) {
  letPress(false);
  try {
    await work();
  } catch (error) {
    if (error.code === "sign_in_too_old") return signInAgain();
    say(error.message);
    if (error.code === "second_factor_needed" || error.code === "second_factor_wrong") {
      letPress(true);
      return askForSecondFactor();
    }
  }
  letPress(true);
}

async function whoIsHere() {
  try {
    return await ask("GET", "/me");
  } catch (error) {
    if (error.status === 401) location.replace("/sign-in?" + new URLSearchParams({ return_to: here() }));
    throw error;
  }
}

function showDecision(me, client, address) {
  const from = address ? ` (asked from ${address})` : "";
  document.getElementById("asks").textContent = `“${client}”${from} asks to sign in as ${me.person.name}.`;
  document.getElementById("decision").hidden = false;
}

function over(text) {
  document.querySelectorAll("form, section").forEach((part) => (part.hidden = true));
  say(text);
}

const forms = {
  password: async (given) => {
    const { email, ...known } = filled(given);
    await ask("POST", isAgain ? "/auth/password/again" : "/auth/password", isAgain ? known : { email, ...known });
    location.assign(home());
  },
  invitation: async (given) => {
    await ask("POST", "/auth/invitation", { ...given, code });
    location.replace(home());
  },
  reset: async (given) => {
    await ask("POST", "/auth/reset", { ...filled(given), code });
    location.replace(home());
  },
  claim: async (given) => {
    await ask("POST", "/auth/claim", { ...given, code: given.code.trim() });
    location.replace(home());
  },
  device: async (given) => {
    const me = await whoIsHere();
    const device = await ask("POST", "/auth/device/look", given);
    document.querySelector("form").hidden = true;
    showDecision(me, device.client, device.address);
  },
};

const decisions = {
  cli: {
    approve: async () => {
      const wanted = { port: Number(asked.get("port")), state: asked.get("state"), code_challenge: asked.get("code_challenge") };
      const told = await ask("POST", "/auth/cli/approve", { ...wanted, client: asked.get("client") || "klein" });
      location.replace(told.url);
    },
    deny: async () => {
      const port = Number(asked.get("port"));
      if (!Number.isInteger(port) || port < 1 || port > 65535) throw new Error("The program did not say where it listens.");
      const told = new URLSearchParams({ error: "denied", state: asked.get("state") || "" });
      location.replace(`http://127.0.0.1:${port}/?${told}`);
    },
  },
  device: {
    approve: async () => {
      await ask("POST", "/auth/device/approve", { user_code: document.querySelector("[name=user_code]").value });
      over("Done: the program signs in within a few seconds. You can close this page.");
    },
    deny: async () => {
      await ask("POST", "/auth/device/deny", { user_code: document.querySelector("[name=user_code]").value });
      over("Refused: the program was told so. You can close this page.");
    },
  },
};

const acts = {
  begin: async (button) => {
    const told = await ask("POST", `/auth/providers/${button.dataset.provider}${isAgain ? "/again" : ""}`, { return_to: home() });
    location.assign(told.url);
  },
  approve: async () => decisions[page].approve(),
  deny: async () => decisions[page].deny(),
};

async function beginAgain() {
  const me = await ask("GET", "/me").catch(() => null);
  if (me === null) return location.replace("/sign-in?" + new URLSearchParams({ return_to: home() }));
  const link = me.emails.length === 0 ? " On the machine of klein up, `klein session link` prints a link for that." : "";
  say(`Sign in once more as ${me.person.name}.${link}`);
  const email = document.querySelector("[name=email]");
  if (email === null) return;
  email.required = false;
  email.closest("label").hidden = true;
}

/** Tells windows of the app that wait for somebody to sign in again; a link does not lead back to them. */
function tellOtherWindows() {
  const channel = new BroadcastChannel("kleinkram.session");
  channel.postMessage("signed-in");
  channel.close();
}

const begin = {
  "sign-in": async () => {
    if (isAgain) await beginAgain();
    document.getElementById("claim").hidden = !(await ask("GET", "/auth/ways")).claim;
  },
  link: async () => {
    history.replaceState(null, "", location.pathname);
    document.getElementById("doing").hidden = true;
    await ask("POST", "/auth/link", { code });
    tellOtherWindows();
    location.replace(home());
  },
  invitation: async () => {
    const whose = await ask("POST", "/auth/codes", { code });
    document.getElementById("for").textContent = `For ${whose.email}`;
    document.querySelector("[name=name]").value = whose.name || "";
  },
  reset: async () => {
    const whose = await ask("POST", "/auth/codes", { code });
    document.getElementById("for").textContent = `For ${whose.name}`;
  },
  device: async () => {
    await whoIsHere();
    document.querySelector("[name=user_code]").value = asked.get("user_code") || "";
  },
  cli: async () => showDecision(await whoIsHere(), asked.get("client") || "klein", "this machine"),
};

for (const form of document.querySelectorAll("form")) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const given = Object.fromEntries(new FormData(form));
    attempt(() => forms[form.dataset.form](given));
  });
}
for (const button of document.querySelectorAll("[data-act]")) {
  button.addEventListener("click", () => attempt(() => acts[button.dataset.act](button)));
}
letPress(true);
if (location.origin !== document.body.dataset.origin) {
  say(`This server is reached at ${document.body.dataset.origin}. Open it there: signing in works at no other address.`);
} else if (begin[page]) {
  attempt(begin[page]);
}
