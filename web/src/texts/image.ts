// Texts of the image panel.
import { counted } from "@/components/format";
import type { ColourMap } from "@/features/viewer/scene/colour_maps";

export const texts = {
  settings: "Settings",
  colourMap: "Colour map",
  automaticMap: (map: string) => `Automatic (${map})`,
  colourMaps: { turbo: "Turbo", viridis: "Viridis", grey: "Grey" } satisfies Record<ColourMap, string>,
  least: (unit: string | null) => (unit === null ? "Range from" : `Range from [${unit}]`),
  greatest: (unit: string | null) => (unit === null ? "Range to" : `Range to [${unit}]`),
  automatic: "Automatic",
  colourBar: (least: string, greatest: string) => `Colours from ${least} to ${greatest}`,
  nothingMeasured: "The picture has no measured values.",
  pixel: (x: number, y: number, value: string) => `${x}, ${y}: ${value}`,
  noValue: "no value",

  annotations: "Annotations",
  noAnnotations: "None",
  automaticAnnotations: (topic: string | null) => (topic === null ? "Automatic (none)" : `Automatic (${topic})`),
  annotationCount: (count: number, topic: string) => `${counted(count, "annotation")} of ${topic}`,
  annotationsMissing: (topic: string) => `No annotations of ${topic} yet`,
  annotationsFailed: (why: string) => `Annotations: ${why}`,
  omitted: (count: number) => `${counted(count, "point")} more ${count === 1 ? "is" : "are"} not drawn`,
} as const;
