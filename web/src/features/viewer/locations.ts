// The locations in the metadata of a mission.

/** Degrees (WGS 84). */
export interface NamedPosition {
  readonly name: string;
  readonly latitude: number;
  readonly longitude: number;
}

const MAX_LOCATIONS = 100;

/** Returns what has a latitude and a longitude, with the name of the place or else of the field. */
export function locationsOf(metadata: Readonly<Record<string, unknown>>): NamedPosition[] {
  return Object.entries(metadata).flatMap(([field, value]) => locationOf(field, value) ?? []).slice(0, MAX_LOCATIONS);
}

function locationOf(field: string, value: unknown): NamedPosition | null {
  if (typeof value !== "object" || value === null) return null;
  const { latitude, longitude, name } = value as { readonly latitude?: unknown; readonly longitude?: unknown; readonly name?: unknown };
  if (typeof latitude !== "number" || typeof longitude !== "number") return null;
  const isUsable = Math.abs(latitude) <= 90 && Math.abs(longitude) <= 180; // false for NaN
  return isUsable ? { name: typeof name === "string" && name !== "" ? name : field, latitude, longitude } : null;
}
