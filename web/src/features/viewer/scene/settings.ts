// What a 3D panel shows and how, as the fields of its series in the address: `frame=map`, `colour=intensity`.
import type { Panel, Series } from "../layout";
import { COLOUR_MAPS, type ColourMap } from "./colour_maps";

/** The settings of the whole panel, which its first series carries. */
export interface SceneSettings {
  /** The frame that does not move; null for the root of the tree of frames. */
  readonly frame: string | null;
  /** A frame that the camera moves with; null for none. */
  readonly follow: string | null;
  readonly pointPx: number;
  /** How long messages stay visible; 0 for the latest only. */
  readonly decaySeconds: number;
  readonly colourMap: ColourMap;
  readonly showsFrames: boolean;
}

export interface TopicSettings {
  readonly isVisible: boolean;
  /** A field, an axis, or empty for one colour; null for the first field. */
  readonly colourBy: string | null;
}

export const POINT_SIZES_PX = [1, 2, 3, 5, 8] as const;
export const DECAYS_SECONDS = [0, 1, 2, 5, 10, 30] as const;
const DEFAULT_POINT_PX = 2;

export function optionsOf({ fields }: Series): ReadonlyMap<string, string> {
  return new Map(fields.map((field): [string, string] => {
    const at = field.indexOf("=");
    return at < 0 ? [field, ""] : [field.slice(0, at), field.slice(at + 1)];
  }));
}

export function oneOf<Choice>(choices: readonly Choice[], text: string | undefined, otherwise: Choice): Choice {
  return choices.find((choice) => String(choice) === text) ?? otherwise;
}

export function sceneSettings({ series }: Pick<Panel, "series">): SceneSettings {
  const options = series[0] === undefined ? new Map<string, string>() : optionsOf(series[0]);
  return {
    frame: options.get("frame") ?? null,
    follow: options.get("follow") ?? null,
    pointPx: oneOf<number>(POINT_SIZES_PX, options.get("size"), DEFAULT_POINT_PX),
    decaySeconds: oneOf<number>(DECAYS_SECONDS, options.get("decay"), 0),
    colourMap: oneOf(COLOUR_MAPS, options.get("map"), COLOUR_MAPS[0]),
    showsFrames: options.has("frames"),
  };
}

export function topicSettings(series: Series): TopicSettings {
  const options = optionsOf(series);
  return { isVisible: !options.has("hidden"), colourBy: options.get("colour") ?? null };
}

/** Returns the series with an option; null removes it. */
export function withOption(series: Series, name: string, value: string | null): Series {
  const options = new Map(optionsOf(series));
  if (value === null) options.delete(name);
  else options.set(name, value);
  return { ...series, fields: [...options].map(([option, text]) => (text === "" && option !== "colour" ? option : `${option}=${text}`)) };
}

/** Returns the panel with an option of the whole panel. */
export function withSceneOption(panel: Panel, name: string, value: string | null): Panel {
  const [first, ...others] = panel.series;
  return first === undefined ? panel : { ...panel, series: [withOption(first, name, value), ...others] };
}

/** Returns the panel without a topic; the next one takes over the settings of the panel. */
export function withoutTopic(panel: Panel, place: number): Panel {
  const { frame, follow, pointPx, decaySeconds, colourMap, showsFrames } = sceneSettings(panel);
  const rest = { ...panel, series: panel.series.toSpliced(place, 1) };
  if (place > 0) return rest;
  const options: readonly (readonly [string, string | null])[] = [
    ["frame", frame], ["follow", follow], ["size", String(pointPx)], ["decay", String(decaySeconds)], ["map", colourMap], ["frames", showsFrames ? "" : null],
  ];
  return options.reduce<Panel>((changed, [name, value]) => withSceneOption(changed, name, value), rest);
}
