// All routes. Each page is a chunk of its own. The server serves the app only below these first path segments, which
// `WEB_PATHS` in server/access/operations.py lists too; server/shares serves the viewer of share links.
import type { RouteRecordRaw } from "vue-router";
import { homeQuery } from "@/features/home/queries";

declare module "vue-router" {
  interface RouteMeta {
    /** Whether the page is open to visitors without an account. */
    guests?: boolean;
    /** Shown without the app around it. */
    bare?: boolean;
    /** A query of the page, started while its chunk loads. */
    prefetch?: typeof homeQuery;
  }
}

const guests = { guests: true };

export const routes: RouteRecordRaw[] = [
  { path: "/", name: "home", meta: { prefetch: homeQuery }, component: () => import("@/features/home/HomePage.vue") },
  { path: "/public", name: "public", meta: guests, component: () => import("@/features/share/PublicPage.vue") },
  { path: "/projects", name: "projects", component: () => import("@/features/project/ProjectsPage.vue") },
  { path: "/projects/:projectId", name: "project", meta: guests, component: () => import("@/features/project/ProjectPage.vue") },
  { path: "/missions/:missionId", name: "mission", meta: guests, component: () => import("@/features/mission/MissionPage.vue") },
  { path: "/missions/:missionId/view", name: "mission-view", meta: guests, component: () => import("@/features/viewer/ViewerPage.vue") },
  { path: "/files/:fileId/view", name: "file-view", meta: guests, component: () => import("@/features/viewer/ViewerPage.vue") },
  { path: "/files/:fileId", name: "file", meta: guests, component: () => import("@/features/file/FilePage.vue") },
  { path: "/upload", name: "upload", component: () => import("@/features/upload/UploadPage.vue") },
  { path: "/search", name: "search", meta: guests, component: () => import("@/features/search/SearchPage.vue") },
  { path: "/actions", name: "actions", component: () => import("@/features/actions/ActionsPage.vue") },
  { path: "/actions/:actionId", name: "action", component: () => import("@/features/actions/ActionPage.vue") },
  { path: "/runs", name: "runs", component: () => import("@/features/runs/RunsPage.vue") },
  { path: "/run-metrics", name: "metrics", component: () => import("@/features/metrics/MetricsPage.vue") },
  { path: "/runs/new", name: "launch", component: () => import("@/features/launch/LaunchPage.vue") },
  { path: "/runs/:runId", name: "run", component: () => import("@/features/runs/RunPage.vue") },
  { path: "/people", name: "people", component: () => import("@/features/people/PeoplePage.vue") },
  { path: "/people/access", name: "access", component: () => import("@/features/people/AccessPage.vue") },
  { path: "/people/:personId", name: "person", component: () => import("@/features/people/PersonPage.vue") },
  { path: "/groups", name: "groups", component: () => import("@/features/groups/GroupsPage.vue") },
  { path: "/groups/:groupId", name: "group", component: () => import("@/features/groups/GroupPage.vue") },
  { path: "/account", name: "account", component: () => import("@/features/account/AccountPage.vue") },
  { path: "/tokens", name: "tokens", component: () => import("@/features/tokens/TokensPage.vue") },
  { path: "/sessions", name: "sessions", component: () => import("@/features/account/SessionsPage.vue") },
  { path: "/audit", name: "audit", component: () => import("@/features/audit/AuditPage.vue") },
  { path: "/trash", name: "trash", component: () => import("@/features/trash/TrashPage.vue") },
  { path: "/admin", name: "admin", component: () => import("@/features/admin/AdminPage.vue") },
  { path: "/signed-in", name: "signed-in", meta: { guests: true, bare: true }, component: () => import("@/shell/SignedInPage.vue") },
  { path: "/s/view", name: "shared-view", meta: { guests: true, bare: true }, component: () => import("@/features/share/SharedViewPage.vue") },
  { path: "/:path(.*)*", name: "not-found", meta: guests, component: () => import("@/shell/NotFoundPage.vue") },
];
