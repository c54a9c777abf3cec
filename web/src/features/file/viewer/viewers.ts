// Viewers by message type. To add a viewer, write its component and add a line to `viewers`.
import type { Component } from "vue";
import ImageViewer from "./ImageViewer.vue";
import PlotViewer from "./PlotViewer.vue";
import type { Topic } from "@/api/types";
import { isPictureType } from "@/recordings/pictures/picture";

export interface Viewer {
  readonly name: string;
  readonly accepts: (messageType: string | null) => boolean;
  /** Has the props `reader` (RecordingReader), `topic` (Topic) and `span` (time of the recording). */
  readonly component: Component;
}

const plot: Viewer = { name: "plot", accepts: () => true, component: PlotViewer };

/** In order of precedence: the first viewer that accepts a type shows it. */
const viewers: readonly Viewer[] = [{ name: "image", accepts: isPictureType, component: ImageViewer }, plot];

export function viewerOf({ message_type }: Topic): Viewer {
  return viewers.find(({ accepts }) => accepts(message_type)) ?? plot;
}

/** Returns the topic to show: the one of that name, else the first with a viewer of its own, else the busiest. */
export function defaultTopic(topics: readonly Topic[], name: string): Topic | null {
  const named = topics.find((topic) => topic.name === name);
  if (named !== undefined) return named;
  const filled = topics.filter(({ count }) => count !== 0);
  const busiest = filled.toSorted((a, b) => (b.count ?? 0) - (a.count ?? 0))[0];
  return filled.find((topic) => viewerOf(topic) !== plot) ?? busiest ?? topics[0] ?? null;
}
