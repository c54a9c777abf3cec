// The way out: ends the session, and leaves nothing of it on the page.
import { api, call } from "@/api/client";
import { toProblem } from "@/api/problem";
import { tell } from "@/components/toasts";

/** Signs out, and goes to the page on which one signs in. */
export async function signOut(): Promise<void> {
  try {
    await call(api.POST("/api/v1/auth/sign-out"));
    globalThis.location.assign("/sign-in");
  } catch (thrown) {
    tell({ tone: "bad", text: toProblem(thrown).message });
  }
}
