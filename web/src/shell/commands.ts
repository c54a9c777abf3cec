// Pages of the navigation and commands of the palette.
import type { RouteLocationRaw } from "vue-router";
import { chooseTheme, THEMES } from "./theme";
import type { Mission, Project } from "@/api/types";
import {
  iconAction,
  iconAdmin,
  iconAudit,
  iconFolder,
  iconHome,
  iconKeys,
  iconMe,
  iconMission,
  iconPeople,
  iconProjects,
  iconPublic,
  iconRuns,
  iconSearch,
  iconSession,
  iconSignOut,
  iconTable,
  iconTheme,
  iconToken,
  iconTrash,
  iconUpload,
} from "@/components/icons";
import { texts } from "@/texts/shell";
import { ref } from "vue";
import { api, call } from "@/api/client";
import { toProblem } from "@/api/problem";
import { showToast } from "@/components/toasts";

interface Offer {
  readonly id: string;
  readonly label: string;
  readonly hint: string;
  readonly icon: string;
}

export type Command = Offer & ({ readonly to: RouteLocationRaw } | { readonly run: () => void });

export interface Viewer {
  readonly isSignedIn: boolean;
  readonly isAdmin: boolean;
}

/** Returns whether a text contains all typed letters in their order. */
export function matches(text: string, typed: string): boolean {
  const within = text.toLocaleLowerCase();
  let at = 0;
  for (const letter of typed.toLocaleLowerCase().replaceAll(" ", "")) {
    at = within.indexOf(letter, at) + 1;
    if (at === 0) return false;
  }
  return true;
}

function placeCommand(place: Place): Command {
  return { id: `place ${place.name}`, label: place.label, hint: texts.kinds.place, icon: place.icon, to: place.to };
}

function appCommands(): readonly Command[] {
  const hint = texts.kinds.act;
  return [
    ...THEMES.map((theme) => ({
      id: `theme ${theme}`, label: `${texts.theme.title}: ${texts.theme[theme]}`, hint, icon: iconTheme, run: () => chooseTheme(theme),
    })),
    { id: "keys", label: texts.keys, hint, icon: iconKeys, run: () => (isShowingKeys.value = true) },
    { id: "sign-out", label: texts.signOut, hint, icon: iconSignOut, run: () => void signOut() },
  ];
}

/** Returns the pages and commands whose names match. */
export function commandsFor(typed: string, viewer: Viewer): readonly Command[] {
  const places = placesFor(viewer.isSignedIn, viewer.isAdmin).map(placeCommand);
  const further = viewer.isSignedIn ? [...furtherPlaces.map(placeCommand), ...appCommands()] : [];
  if (typed === "") return [...places, ...further.slice(0, furtherPlaces.length)];
  return [...places, ...further].filter((item) => matches(item.label, typed));
}

/** Returns projects and missions as places to go to. */
export function objectCommands(projects: readonly Project[], missions: readonly Mission[]): readonly Command[] {
  return [
    ...projects.map((project) => ({
      id: project.id, label: project.name, hint: texts.kinds.project, icon: iconFolder,
      to: { name: "project", params: { projectId: project.id } },
    })),
    ...missions.map((mission) => ({
      id: mission.id, label: mission.name, hint: mission.project.name, icon: iconMission,
      to: { name: "mission", params: { missionId: mission.id } },
    })),
  ];
}

/** Returns a command that searches for the typed text. */
export function searchCommand(typed: string): Command {
  return { id: "search", label: texts.searchFor(typed), hint: texts.kinds.place, icon: iconSearch, to: { name: "search", query: { q: typed } } };
}

export const isShowingKeys = ref(false);
export const isShowingPalette = ref(false);

/** Signs out, and opens the sign-in page. */
export async function signOut(): Promise<void> {
  try {
    await call(api.POST("/api/v1/auth/sign-out"));
    globalThis.location.assign("/sign-in");
  } catch (thrown) {
    showToast({ tone: "bad", text: toProblem(thrown).message });
  }
}

export interface Place {
  readonly name: string;
  readonly label: string;
  readonly icon: string;
  readonly to: RouteLocationRaw;
  /** Names of other routes that belong to it. */
  readonly also: readonly string[];
  /** The second key after `g` that leads there. */
  readonly key: string;
  readonly forAdmins?: boolean;
}

function place(name: keyof typeof texts.places, icon: string, key: string, more: Partial<Place> = {}): Place {
  return { name, label: texts.places[name], icon, to: { name }, also: [], key, ...more };
}

export const places: readonly Place[] = [
  place("home", iconHome, "h"),
  place("projects", iconProjects, "p", { also: ["project", "mission", "mission-view", "file", "file-view"] }),
  place("search", iconSearch, "s"),
  place("upload", iconUpload, "u"),
  place("actions", iconAction, "i", { also: ["action"] }),
  place("runs", iconRuns, "x", { also: ["run", "launch"] }),
  place("metrics", iconTable, "m"),
  place("people", iconPeople, "e", { also: ["person", "groups", "group", "access"] }),
  place("trash", iconTrash, "t"),
  place("audit", iconAudit, "r"),
  place("admin", iconAdmin, "a", { forAdmins: true }),
];

/** Pages that the rail does not show, and the palette does. */
export const furtherPlaces: readonly Place[] = [
  place("groups", iconPeople, "o"),
  place("account", iconMe, "c"),
  place("tokens", iconToken, "k"),
  place("sessions", iconSession, "n"),
  place("public", iconPublic, "b"),
];

/** The pages for visitors without an account. */
export const publicPlaces: readonly Place[] = [place("public", iconPublic, "b"), place("search", iconSearch, "s")];

/** Returns the places in the navigation. */
export function placesFor(isSignedIn: boolean, isAdmin: boolean): readonly Place[] {
  return isSignedIn ? places.filter((item) => isAdmin || item.forAdmins !== true) : publicPlaces;
}

/** Whether a route belongs to a page of the navigation. */
export function belongsTo(where: Place, routeName: unknown): boolean {
  return typeof routeName === "string" && (where.name === routeName || where.also.includes(routeName));
}
