// The one way to the API: typed by its own description, signed in by the browser's cookie, failing with a Problem.
// A browser says by itself from which page a request comes, which is what the server asks of whoever changes anything.
import createClient from "openapi-fetch";
import type { paths } from "./schema";
import { problemOf, toProblem } from "./problem";
import { signInAgain } from "./signing-in";

const NOT_AUTHENTICATED = 401;

/** Sends a request; where the session has ended meanwhile, waits until one has signed in again, then sends it anew. */
async function send(request: Request): Promise<Response> {
  const again = request.clone();
  const answer = await fetch(request);
  if (!(await hasEnded(answer)) || !(await signInAgain())) return answer;
  return fetch(again);
}

/** Says whether an answer is that of a session which has ended: a password that is wrong is refused with 401 as well. */
async function hasEnded(answer: Response): Promise<boolean> {
  if (answer.status !== NOT_AUTHENTICATED) return false;
  const told: unknown = await answer.clone().json().catch(() => null);
  return !(typeof told === "object" && told !== null && "code" in told && told.code === "sign_in_failed");
}

/** The API, one method a verb: `call(api.GET("/api/v1/projects", { params }))`. */
export const api = createClient<paths>({ baseUrl: globalThis.location.origin, fetch: send });

interface Told<Data> {
  readonly data?: Data;
  readonly error?: unknown;
  readonly response: Response;
}

/**
 * Returns what a request was answered with.
 *
 * @throws {Problem} it failed, or nothing answered.
 */
export async function call<Data>(asked: Promise<Told<Data>>): Promise<Data> {
  let told: Told<Data>;
  try {
    told = await asked;
  } catch (thrown) {
    if (thrown instanceof DOMException && thrown.name === "AbortError") throw thrown;
    throw toProblem(thrown);
  }
  if (!told.response.ok) throw problemOf(told.error, told.response);
  return told.data as Data;
}
