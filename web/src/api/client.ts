// The API client: typed by the OpenAPI description, authenticated by the session cookie, or by the secret of a share link.
// Failures are thrown as `Problem`.
// Browsers add the `Origin` header, which the server checks on every change.
import createClient from "openapi-fetch";
import type { paths } from "./schema";
import { problemOf, toProblem } from "./problem";
import { readonly, ref } from "vue";

const NOT_AUTHENTICATED = 401;
const FORBIDDEN = 403;

let ofLink: string | null = null;

/** Sends requests with the secret of a share link from now on, instead of the session of this browser; null: with the session. */
export function readWithLink(secret: string | null): void {
  ofLink = secret;
}

/** The secret of the share link that this page reads with; null where it reads with a session. */
export function linkSecret(): string | null {
  return ofLink;
}

function withSecret(request: Request, secret: string): Request {
  const own = new Request(request, { credentials: "omit" });
  own.headers.set("Authorization", `Bearer ${secret}`);
  return own;
}

/** Sends a request. If the user must sign in again, waits for that, then sends the request again. */
async function send(request: Request): Promise<Response> {
  if (ofLink !== null) return fetch(withSecret(request, ofLink));
  const again = request.clone();
  const answer = await fetch(request);
  const why = await whySignInAgain(answer);
  if (why === null || !(await signInAgain(why))) return answer;
  return fetch(again);
}

/** Returns whether the session has ended (a wrong password or code is refused with 401 as well), or began too long ago. */
async function whySignInAgain(answer: Response): Promise<"ended" | "too old" | null> {
  if (answer.status !== NOT_AUTHENTICATED && answer.status !== FORBIDDEN) return null;
  const body: unknown = await answer.clone().json().catch(() => null);
  const code = typeof body === "object" && body !== null && "code" in body ? body.code : "";
  if (code === "sign_in_too_old") return "too old";
  const isWrong = code === "sign_in_failed" || code === "second_factor_needed" || code === "second_factor_wrong";
  return answer.status === NOT_AUTHENTICATED && !isWrong ? "ended" : null;
}

/** The API, one method a verb: `call(api.GET("/api/v1/projects", { params }))`. */
export const api = createClient<paths>({ baseUrl: globalThis.location.origin, fetch: send });

interface ApiResponse<Data> {
  readonly data?: Data;
  readonly error?: unknown;
  readonly response: Response;
}

/**
 * Returns the body of a response.
 *
 * @throws {Problem} it failed, or nothing answered.
 */
export async function call<Data>(pending: Promise<ApiResponse<Data>>): Promise<Data> {
  let body: ApiResponse<Data>;
  try {
    body = await pending;
  } catch (thrown) {
    if (thrown instanceof DOMException && thrown.name === "AbortError") throw thrown;
    throw toProblem(thrown);
  }
  if (!body.response.ok) throw problemOf(body.error, body.response);
  return body.data as Data;
}

const CHANNEL = "kleinkram.session";

type Outcome = (isSignedIn: boolean) => void;

let wasSignedIn = false;
let waiting: Outcome[] = [];
const signInRequired = ref(false);
const tooOld = ref(false);

/** Whether requests wait until the user has signed in again. */
export const isSignInRequired = readonly(signInRequired);

/** Whether the session is valid, but too old for the action. */
export const isSignInTooOld = readonly(tooOld);

/** Notes that the user was signed in on this page: later 401 responses mean that the session has ended. */
export function noteSignedIn(isSignedIn: boolean): void {
  wasSignedIn = isSignedIn;
}

/** Waits until the user has signed in again. False if nobody was signed in, or if they decline. */
export function signInAgain(why: "ended" | "too old" = "ended"): Promise<boolean> {
  if (!wasSignedIn) return Promise.resolve(false);
  if (!signInRequired.value) tooOld.value = why === "too old";
  signInRequired.value = true;
  return new Promise((resolve) => waiting.push(resolve));
}

/** Continues or fails the waiting requests. */
export function finishSignIn(isSignedIn: boolean): void {
  const waited = waiting;
  waiting = [];
  signInRequired.value = false;
  if (!isSignedIn && !tooOld.value) wasSignedIn = false;
  tooOld.value = false;
  for (const outcome of waited) outcome(isSignedIn);
}

/** Notifies the other windows of this browser of a sign-in. */
export function announceSignedIn(): void {
  const channel = new BroadcastChannel(CHANNEL);
  channel.postMessage("signed-in");
  channel.close();
}

/** Calls back when another window has signed in; returns a function that stops that. */
export function onSignedIn(callback: () => void): () => void {
  const channel = new BroadcastChannel(CHANNEL);
  channel.addEventListener("message", callback);
  return () => channel.close();
}

/** Returns the URL of the sign-in page, which returns to a page of the app. */
export function signInAddress(returnTo: string, again = false): string {
  return `/sign-in?${new URLSearchParams({ return_to: returnTo, ...(again ? { again: "1" } : {}) }).toString()}`;
}

/** The ETag of the version that a change is based on. */
export interface EtagCarrier {
  readonly etag?: string | undefined;
}

// ETags replaced by changes of this page: of two open forms, saving one does not invalidate the other.
const own = new Map<string, string>();

/** Records that a change of this page replaced one ETag by another. */
export function noteNewEtag(from: string | undefined, to: string | undefined): void {
  if (from === undefined || to === undefined || from === to) return;
  own.delete(to); // it is the newest now, also where it was there before
  own.set(latest(from), to);
}

/** Returns the header that makes the server reject a change of any version but this one and those that this page made of it. */
export function ifMatch(etag: string | undefined): { readonly "If-Match"?: string } {
  return etag === undefined ? {} : { "If-Match": `"${latest(etag)}"` };
}

function latest(etag: string): string {
  let at = etag;
  for (let next = own.get(at); next !== undefined; next = own.get(at)) at = next;
  return at;
}
