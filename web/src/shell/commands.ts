// What the palette offers for what was typed.
import type { RouteLocationRaw } from "vue-router";
import { isShowingKeys } from "./open";
import { furtherPlaces, type Place, placesFor } from "./places";
import { signOut } from "./signOut";
import { chooseTheme, THEMES } from "./theme";
import type { Mission, Project } from "@/api/types";
import { iconFolder, iconKeys, iconMission, iconSearch, iconSignOut, iconTheme } from "@/components/icons";
import { texts } from "@/texts/shell";

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

/** Says whether all letters of what was typed occur in a text, in their order. */
export function matches(text: string, typed: string): boolean {
  const within = text.toLocaleLowerCase();
  let at = 0;
  for (const letter of typed.toLocaleLowerCase().replaceAll(" ", "")) {
    at = within.indexOf(letter, at) + 1;
    if (at === 0) return false;
  }
  return true;
}

function going(place: Place): Command {
  return { id: `place ${place.name}`, label: place.label, hint: texts.kinds.place, icon: place.icon, to: place.to };
}

function acts(): readonly Command[] {
  const hint = texts.kinds.act;
  return [
    ...THEMES.map((theme) => ({
      id: `theme ${theme}`, label: `${texts.theme.title}: ${texts.theme[theme]}`, hint, icon: iconTheme, run: () => chooseTheme(theme),
    })),
    { id: "keys", label: texts.keys, hint, icon: iconKeys, run: () => (isShowingKeys.value = true) },
    { id: "sign-out", label: texts.signOut, hint, icon: iconSignOut, run: () => void signOut() },
  ];
}

/** Returns the pages and acts whose names match. */
export function commandsFor(typed: string, viewer: Viewer): readonly Command[] {
  const places = placesFor(viewer.isSignedIn, viewer.isAdmin).map(going);
  const further = viewer.isSignedIn ? [...furtherPlaces.map(going), ...acts()] : [];
  if (typed === "") return [...places, ...further.slice(0, furtherPlaces.length)];
  return [...places, ...further].filter((each) => matches(each.label, typed));
}

/** Returns projects and missions as places to go to. */
export function found(projects: readonly Project[], missions: readonly Mission[]): readonly Command[] {
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

/** Returns the way to a search for what was typed. */
export function searchCommand(typed: string): Command {
  return { id: "search", label: texts.searchFor(typed), hint: texts.kinds.place, icon: iconSearch, to: { name: "search", query: { q: typed } } };
}
