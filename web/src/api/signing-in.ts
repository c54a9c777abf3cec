// What happens when a session ends while somebody works: nothing on the page is lost. Requests wait while they sign in
// in another window, then go on.
import { readonly, ref } from "vue";

const CHANNEL = "kleinkram.session";

type Outcome = (isSignedIn: boolean) => void;

let wasSignedIn = false;
let waiting: Outcome[] = [];
const asking = ref(false);
const tooOld = ref(false);

/** Whether requests wait for somebody to sign in again. */
export const isAskingToSignIn = readonly(asking);

/** Whether they are signed in still, and only too long ago for what they want to do. */
export const isSignInTooOld = readonly(tooOld);

/** Remembers that somebody was signed in on this page: from now on a refused request is one whose session has ended. */
export function noteSignedIn(isSignedIn: boolean): void {
  wasSignedIn = isSignedIn;
}

/** Waits until somebody has signed in again. Says no at once where nobody had been, and when they decline. */
export function signInAgain(why: "ended" | "too old" = "ended"): Promise<boolean> {
  if (!wasSignedIn) return Promise.resolve(false);
  if (!asking.value) tooOld.value = why === "too old";
  asking.value = true;
  return new Promise((resolve) => waiting.push(resolve));
}

/** Lets the requests that wait go on, or fail. */
export function settle(isSignedIn: boolean): void {
  const waited = waiting;
  waiting = [];
  asking.value = false;
  if (!isSignedIn && !tooOld.value) wasSignedIn = false;
  tooOld.value = false;
  for (const outcome of waited) outcome(isSignedIn);
}

/** Tells the other windows of this browser that somebody has signed in. */
export function tellSignedIn(): void {
  const channel = new BroadcastChannel(CHANNEL);
  channel.postMessage("signed-in");
  channel.close();
}

/** Calls back whenever another window has signed in; returns what ends that. */
export function onSignedIn(callback: () => void): () => void {
  const channel = new BroadcastChannel(CHANNEL);
  channel.addEventListener("message", callback);
  return () => channel.close();
}

/** Returns where one signs in, and comes back from to a page of the app. */
export function signInAddress(returnTo: string, again = false): string {
  return `/sign-in?${new URLSearchParams({ return_to: returnTo, ...(again ? { again: "1" } : {}) }).toString()}`;
}
