// Where the rail, the bar and the palette lead.
import type { RouteLocationRaw } from "vue-router";
import {
  iconAction, iconAdmin, iconAudit, iconHome, iconMe, iconPeople, iconProjects, iconPublic, iconRuns, iconSearch, iconSession, iconToken, iconTrash,
  iconUpload,
} from "@/components/icons";
import { texts } from "@/texts/shell";

export interface Place {
  readonly name: string;
  readonly label: string;
  readonly icon: string;
  readonly to: RouteLocationRaw;
  /** Names of the other pages that belong to it. */
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
  place("projects", iconProjects, "p", { also: ["project", "mission", "file"] }),
  place("search", iconSearch, "s"),
  place("upload", iconUpload, "u"),
  place("actions", iconAction, "i", { also: ["action"] }),
  place("runs", iconRuns, "x", { also: ["run", "launch"] }),
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

/** What strangers may go to. */
export const publicPlaces: readonly Place[] = [place("public", iconPublic, "b"), place("search", iconSearch, "s")];

/** Returns the places of somebody. */
export function placesFor(isSignedIn: boolean, isAdmin: boolean): readonly Place[] {
  return isSignedIn ? places.filter((each) => isAdmin || each.forAdmins !== true) : publicPlaces;
}

/** Says whether the page of that name belongs to a place. */
export function isAt(where: Place, routeName: unknown): boolean {
  return typeof routeName === "string" && (where.name === routeName || where.also.includes(routeName));
}
