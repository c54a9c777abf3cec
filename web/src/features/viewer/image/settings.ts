// The settings of an image panel, as the fields of its series in the address: `map=viridis`, `least=0.5`.
import type { Series } from "../layout";
import { COLOUR_MAPS, colourTable, type ColourMap } from "../scene/colour_maps";
import { oneOf, optionsOf } from "../scene/settings";
import { greys, type PictureValues, type Range } from "@/recordings/pictures/values";

export interface ImageSettings {
  /** Null: by what the values measure. */
  readonly colourMap: ColourMap | null;
  /** Null: by the values of each picture. */
  readonly least: number | null;
  readonly greatest: number | null;
  /** The topic of the annotations; empty for none, null for the one that fits the name of the image. */
  readonly annotations: string | null;
}

export function imageSettings(series: Series | undefined): ImageSettings {
  const options = series === undefined ? new Map<string, string>() : optionsOf(series);
  return {
    colourMap: oneOf<ColourMap | null>(COLOUR_MAPS, options.get("map"), null),
    least: numberOf(options.get("least")),
    greatest: numberOf(options.get("greatest")),
    annotations: options.get("annotations") ?? null,
  };
}

/** Returns a finite number; null for every other text. */
export function numberOf(text: string | undefined): number | null {
  const number = text === undefined || text.trim() === "" ? Number.NaN : Number(text);
  return Number.isFinite(number) ? number : null;
}

/** Returns the map of a picture: distances have colours, brightness is grey. */
export function colourMapOf({ colourMap }: ImageSettings, { unit }: Pick<PictureValues, "unit">): ColourMap {
  return colourMap ?? (unit === null ? "grey" : "turbo");
}

/** Returns 256 colours; those of a picture go from black to white where they are grey. */
export function pictureTable(map: ColourMap): Uint8Array {
  return map === "grey" ? greys() : colourTable(map);
}

/** Returns the values that get the first and the last colour; null where nothing was measured. */
export function shownRange({ least, greatest }: ImageSettings, { range }: Pick<PictureValues, "range">): Range | null {
  const from = least ?? range?.[0];
  const to = greatest ?? range?.[1];
  return from === undefined || to === undefined ? null : [from, to];
}

/** Returns the topic of annotations in the nearest namespace of the image topic; null where there is none.
 *
 * `/camera/front/detections` fits `/camera/front/image/compressed`, not `/camera/rear/image`.
 */
export function annotationTopicFor(imageTopic: string, topics: readonly string[]): string | null {
  const fitting = topics.map((topic) => ({ topic, namespace: topic.slice(0, topic.lastIndexOf("/") + 1) }))
    .filter(({ namespace }) => namespace.length > 1 && imageTopic.startsWith(namespace))
    .toSorted((a, b) => b.namespace.length - a.namespace.length);
  return fitting[0]?.topic ?? null;
}
