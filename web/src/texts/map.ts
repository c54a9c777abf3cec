// Texts of maps.
import { counted } from "@/components/format";

export const texts = {
  zoomIn: "Zoom in",
  zoomOut: "Zoom out",
  fit: "Show everything",
  length: (metres: number) => (metres >= 1_000 ? `${metres / 1_000} km` : metres >= 1 ? `${metres} m` : `${Number((metres * 100).toPrecision(2))} cm`),

  missions: "Map of missions",
  missionsKeys: "Drag to move, turn the wheel to zoom. Keys: arrows, +, -, and 0 to show everything.",
  several: (count: number, position: string) => `${counted(count, "mission")} near ${position}`,
  position: (latitude: number, longitude: number) => `${latitude.toFixed(5)}°, ${longitude.toFixed(5)}°`,
  fromMetadata: "Position from the metadata",
  close: "Close the list",
  moreHere: (count: number) => `${counted(count, "more mission")} here are not listed.`,
  shown: (count: number) => `${counted(count, "mission")} on the map, where their recordings have the first GNSS fix, or at the location in their metadata.`,
  unplaced: (count: number) => `Not on the map: ${counted(count, "mission")} with neither a GNSS fix in the previews of recordings nor coordinates in the metadata. Shapes (GeoJSON) do not place a mission.`,
  leftOut: (count: number) => `${counted(count, "earlier mission")} not shown. Filter to see them.`,
  nothing: "No mission with a position",
  nothingWhy: "Positions come from the previews of recordings with GNSS fixes, and from metadata fields of the type location that have coordinates. Shapes (GeoJSON) do not place a mission.",
} as const;
