// The one way to the API: typed by its own description, signed in by the browser's cookie, failing with a Problem.
// A browser says by itself from which page a request comes, which is what the server asks of whoever changes anything.
import createClient from "openapi-fetch";
import type { paths } from "./schema";
import { problemOf, toProblem } from "./problem";
import { signInAgain } from "./signing-in";

const NOT_AUTHENTICATED = 401;
const FORBIDDEN = 403;

/** Sends a request; where it takes to sign in again, waits until that is done, then sends it anew. */
async function send(request: Request): Promise<Response> {
  const again = request.clone();
  const answer = await fetch(request);
  const why = await whySignInAgain(answer);
  if (why === null || !(await signInAgain(why))) return answer;
  return fetch(again);
}

/** Says whether the session has ended (a wrong password or code is refused with 401 as well), or began too long ago. */
async function whySignInAgain(answer: Response): Promise<"ended" | "too old" | null> {
  if (answer.status !== NOT_AUTHENTICATED && answer.status !== FORBIDDEN) return null;
  const told: unknown = await answer.clone().json().catch(() => null);
  const code = typeof told === "object" && told !== null && "code" in told ? told.code : "";
  if (code === "sign_in_too_old") return "too old";
  const isWrong = code === "sign_in_failed" || code === "second_factor_needed" || code === "second_factor_wrong";
  return answer.status === NOT_AUTHENTICATED && !isWrong ? "ended" : null;
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
