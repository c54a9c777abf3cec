// Script of the sign-in pages: calls the JSON API and shows its messages. Never evaluates code, and never inserts text as HTML.
"use strict";

const page = document.body.dataset.page;
const query = new URLSearchParams(location.search);
const code = location.hash.slice(1);

function showMessage(text) {
  const message = document.getElementById("message");
  message.textContent = text;
  message.hidden = false;
}

// Only a path of this server, however it is written.
function returnTo() {
  const path = query.get("return_to") || "/";
  return /^\/($|[^/\\])/.test(path) && new URL(path, location.origin).origin === location.origin ? path : "/";
}

function currentPath() {
  return location.pathname + location.search;
}

async function callApi(method, path, body) {
  const response = await fetch("/api/v1" + path, {
    method,
    headers: body === undefined ? {} : { "Content-Type": "application/json" },
    body: body === undefined ? undefined : JSON.stringify(body),
  });
  const result = response.status === 204 ? null : await response.json();
  if (!response.ok) throw Object.assign(new Error(result.detail), { status: response.status, code: result.code });
  return result;
}

// Reauthenticates within the session of a person whose sign-in is too old.
const isReauthentication = query.has("again");

function redirectToReauthenticate() {
  location.replace("/sign-in?" + new URLSearchParams({ return_to: currentPath(), again: "1" }));
}

function showSecondFactor() {
  const field = document.getElementById("second-factor");
  field.hidden = false;
  field.querySelector("input").focus();
}

// Leaves an empty second factor out.
function withoutEmpty(fields) {
  return Object.fromEntries(Object.entries(fields).filter(([name, value]) => name !== "second_factor" || value));
}

function enableButtons(isEnabled) {
  document.querySelectorAll("button").forEach((button) => (button.disabled = !isEnabled));
}

async function attempt(work) {
  enableButtons(false);
  try {
    await work();
  } catch (error) {
    if (error.code === "sign_in_too_old") return redirectToReauthenticate();
    showMessage(error.message);
    if (error.code === "second_factor_needed" || error.code === "second_factor_wrong") {
      enableButtons(true);
      return showSecondFactor();
    }
  }
  enableButtons(true);
}

async function requireSignIn() {
  try {
    return await callApi("GET", "/me");
  } catch (error) {
    if (error.status === 401) location.replace("/sign-in?" + new URLSearchParams({ return_to: currentPath() }));
    throw error;
  }
}

function showDecision(me, client, address) {
  const from = address ? ` (from ${address})` : "";
  document.getElementById("asks").textContent = `“${client}”${from} asks to sign in as ${me.person.name}.`;
  document.getElementById("decision").hidden = false;
}

function finish(text) {
  document.querySelectorAll("form, section").forEach((part) => (part.hidden = true));
  showMessage(text);
}

const forms = {
  password: async (fields) => {
    const { email, ...known } = withoutEmpty(fields);
    await callApi("POST", isReauthentication ? "/auth/password/reauthenticate" : "/auth/password", isReauthentication ? known : { email, ...known });
    location.assign(returnTo());
  },
  invitation: async (fields) => {
    await callApi("POST", "/auth/invitation", { ...fields, code });
    location.replace(returnTo());
  },
  reset: async (fields) => {
    await callApi("POST", "/auth/reset", { ...withoutEmpty(fields), code });
    location.replace(returnTo());
  },
  bootstrap: async (fields) => {
    await callApi("POST", "/auth/bootstrap", { ...fields, code: fields.code.trim() });
    location.replace(returnTo());
  },
  device: async (fields) => {
    const me = await requireSignIn();
    const device = await callApi("POST", "/auth/device/status", fields);
    document.querySelector("form").hidden = true;
    showDecision(me, device.client, device.address);
  },
};

const decisions = {
  cli: {
    approve: async () => {
      const request = { port: Number(query.get("port")), state: query.get("state"), code_challenge: query.get("code_challenge") };
      const result = await callApi("POST", "/auth/cli/approve", { ...request, client: query.get("client") || "klein" });
      location.replace(result.url);
    },
    deny: async () => {
      const port = Number(query.get("port"));
      if (!Number.isInteger(port) || port < 1 || port > 65535) throw new Error("The address lacks the port of the program.");
      const denial = new URLSearchParams({ error: "denied", state: query.get("state") || "" });
      location.replace(`http://127.0.0.1:${port}/?${denial}`);
    },
  },
  device: {
    approve: async () => {
      await callApi("POST", "/auth/device/approve", { user_code: document.querySelector("[name=user_code]").value });
      finish("Done: the program signs in within a few seconds. You can close this page.");
    },
    deny: async () => {
      await callApi("POST", "/auth/device/deny", { user_code: document.querySelector("[name=user_code]").value });
      finish("Denied. You can close this page.");
    },
  },
};

const acts = {
  start: async (button) => {
    const result = await callApi("POST", `/auth/providers/${button.dataset.provider}${isReauthentication ? "/reauthenticate" : ""}`, { return_to: returnTo() });
    location.assign(result.url);
  },
  approve: async () => decisions[page].approve(),
  deny: async () => decisions[page].deny(),
};

async function startReauthentication() {
  const me = await callApi("GET", "/me").catch(() => null);
  if (me === null) return location.replace("/sign-in?" + new URLSearchParams({ return_to: returnTo() }));
  const link = me.emails.length === 0 ? " On the machine of klein up, `klein session link` prints a link for that." : "";
  showMessage(`Sign in once more as ${me.person.name}.${link}`);
  const email = document.querySelector("[name=email]");
  if (email === null) return;
  email.required = false;
  email.closest("label").hidden = true;
}

/** Notifies windows of the app that wait for a sign-in. */
function tellOtherWindows() {
  const channel = new BroadcastChannel("kleinkram.session");
  channel.postMessage("signed-in");
  channel.close();
}

const onLoad = {
  "sign-in": async () => {
    if (isReauthentication) await startReauthentication();
    document.getElementById("bootstrap").hidden = !(await callApi("GET", "/auth/methods")).bootstrap;
  },
  link: async () => {
    history.replaceState(null, "", location.pathname);
    document.getElementById("doing").hidden = true;
    await callApi("POST", "/auth/link", { code });
    tellOtherWindows();
    location.replace(returnTo());
  },
  invitation: async () => {
    const recipient = await callApi("POST", "/auth/codes", { code });
    document.getElementById("for").textContent = `For ${recipient.email}`;
    document.querySelector("[name=name]").value = recipient.name || "";
  },
  reset: async () => {
    const recipient = await callApi("POST", "/auth/codes", { code });
    document.getElementById("for").textContent = `For ${recipient.name}`;
  },
  device: async () => {
    await requireSignIn();
    document.querySelector("[name=user_code]").value = query.get("user_code") || "";
  },
  cli: async () => showDecision(await requireSignIn(), query.get("client") || "klein", "this machine"),
};

for (const form of document.querySelectorAll("form")) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const fields = Object.fromEntries(new FormData(form));
    attempt(() => forms[form.dataset.form](fields));
  });
}
for (const button of document.querySelectorAll("[data-act]")) {
  button.addEventListener("click", () => attempt(() => acts[button.dataset.act](button)));
}
enableButtons(true);
if (location.origin !== document.body.dataset.origin) {
  showMessage(`The address of this server is ${document.body.dataset.origin}. Signing in works only there.`);
} else if (onLoad[page]) {
  attempt(onLoad[page]);
}
