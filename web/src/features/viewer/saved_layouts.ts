// Layouts that fit other missions: instead of a recording, a series names a place among those that have its topic.
import { panelsOf, panelText, type Panel, type Series } from "./layout";
import { withRecording } from "./plot_curves";
import type { ViewerTopic } from "./queries";

type TopicPlace = Pick<ViewerTopic, "recording" | "name">;

export interface FittedLayout {
  readonly panels: readonly Panel[];
  /** How many panels are not shown, since the mission has none of their topics. */
  readonly leftOut: number;
}

/** Returns panels as they are saved; a panel of topics that do not exist is left out. */
export function portableTexts(panels: readonly Panel[], topics: readonly TopicPlace[]): string[] {
  const keys = recordingsByTopic(topics);
  return withSeries(panels, ({ recording, topic }) => {
    const place = keys.get(topic)?.indexOf(recording) ?? -1;
    return place < 0 ? null : String(place + 1);
  }).map(panelText);
}

/** Returns saved panels as those of a mission with these topics. */
export function fittedLayout(texts: readonly string[], topics: readonly TopicPlace[]): FittedLayout {
  const keys = recordingsByTopic(topics);
  const panels = withSeries(panelsOf(texts), ({ recording, topic }) => keys.get(topic)?.[Number(recording) - 1] ?? null);
  return { panels, leftOut: texts.length - panels.length };
}

function recordingsByTopic(topics: readonly TopicPlace[]): ReadonlyMap<string, readonly string[]> {
  const keys = new Map<string, string[]>();
  for (const { recording, name } of topics) keys.set(name, [...(keys.get(name) ?? []), recording]);
  return keys;
}

/** Returns panels with other recordings; a series or curve without one is left out, and a panel without a series. */
function withSeries(panels: readonly Panel[], recordingOf: (topic: Pick<Series, "recording" | "topic">) => string | null): Panel[] {
  return panels.flatMap((panel) => {
    const series = panel.series.flatMap((one) => {
      const recording = recordingOf(one);
      return recording === null ? [] : [{ ...one, recording, fields: one.fields.flatMap((field) => withRecording(field, recordingOf) ?? []) }];
    });
    return series.length === 0 ? [] : [{ ...panel, series }];
  });
}
