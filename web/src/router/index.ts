// The router: redirects to sign-in where needed, and moves the focus to the heading after navigation.
import { noop, type QueryClient } from "@tanstack/vue-query";
import { createRouter, createWebHistory, START_LOCATION, type RouteLocationNormalized, type Router } from "vue-router";
import { discardOnNavigation } from "./query";
import { routes } from "./routes";
import { toProblem } from "@/api/problem";
import { meQuery } from "@/api/session";
import { linkSecret, readWithLink, signInAddress } from "@/api/client";
import { focusNextHeading } from "@/components/titles";
import { showToast } from "@/components/toasts";
import { texts } from "@/texts/shell";

/** Returns whether the user is signed in; if the server does not respond, the page reports it. */
async function isSignedIn(queries: QueryClient): Promise<boolean> {
  try {
    return (await queries.query(meQuery)) !== null;
  } catch (thrown) {
    toProblem(thrown);
    return true;
  }
}

/** Returns the secret of the share link in an address, which browsers do not send to servers; null for pages of the app. */
function secretOf({ name, hash }: RouteLocationNormalized): string | null {
  return name === "shared-view" ? hash.slice(1) : null;
}

/** Has a document read with one credential as long as it lasts: its cache must not mix what a link and a person see. */
function useOneCredential(router: Router): void {
  router.beforeEach((to, from) => {
    if (from === START_LOCATION) readWithLink(secretOf(to));
  });
  router.afterEach((to, _from, failure) => {
    if (failure === undefined && secretOf(to) !== linkSecret()) globalThis.location.reload();
  });
}

/** Returns the app's router. */
export function openRouter(queries: QueryClient): Router {
  const router = createRouter({
    history: createWebHistory(),
    routes,
    // eslint-disable-next-line @typescript-eslint/no-deprecated -- what shall replace it is still an experiment
    scrollBehavior: (to, from, saved) => {
      if (saved !== null) return saved;
      return to.path === from.path ? false : { top: 0 };
    },
  });
  discardOnNavigation(router);
  useOneCredential(router);
  router.beforeEach(async (to) => {
    if (to.meta.guests === true) return true;
    if (await isSignedIn(queries)) {
      if (to.meta.prefetch !== undefined) queries.query(to.meta.prefetch).catch(noop); // shown by the page
      return true;
    }
    globalThis.location.assign(signInAddress(to.fullPath));
    return false;
  });
  router.afterEach((to, from) => {
    if (to.path !== from.path && from.matched.length > 0) focusNextHeading();
  });
  router.onError((_error, to) => {
    // After an update of the server, the old pages no longer exist: reload once.
    const key = `kleinkram.reloaded ${to.path}`; // without the secret of a link
    if (sessionStorage.getItem(key) === null) {
      sessionStorage.setItem(key, "yes");
      if (secretOf(to) === null) globalThis.location.assign(to.fullPath);
      else globalThis.location.reload(); // an address that differs only in its fragment loads nothing
    } else showToast({ tone: "bad", text: texts.pageGone });
  });
  return router;
}
