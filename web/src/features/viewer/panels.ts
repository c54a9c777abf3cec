// The panels that exist. To add one, write `panels/NamePanel.vue`, which exports its component and its `definition`.
import type { Component } from "vue";
import type { Panel } from "./layout";
import type { ViewerTopic } from "./queries";

export interface PanelDefinition {
  /** In addresses. Lower-case letters. */
  readonly kind: string;
  readonly label: string;
  readonly icon: string;
  /** Whether it shows messages of a type. */
  readonly accepts: (messageType: string | null) => boolean;
  /** How many topics one panel shows. */
  readonly maxTopics: number;
  readonly isWide: boolean;
  /** How many of them the first layout has at most, and which topics they show, the best first. */
  readonly byDefault: { readonly order: number; readonly most: number; readonly rank: (topic: ViewerTopic) => number };
}

export interface PanelKind extends PanelDefinition {
  /** Has the props of `PanelProps`; emits `update` with its new `panel`. */
  readonly component: Component;
}

export interface PanelProps {
  readonly panel: Panel;
  /** Requests are served by ascending priority. */
  readonly priority: number;
}

interface PanelModule {
  readonly default: Component;
  readonly definition: PanelDefinition;
}

const modules = import.meta.glob<PanelModule>("./panels/*Panel.vue", { eager: true });

export const panelKinds: readonly PanelKind[] = Object.values(modules)
  .map(({ default: component, definition }) => ({ ...definition, component }))
  .toSorted((a, b) => a.byDefault.order - b.byDefault.order);

export function kindOf({ kind }: Panel): PanelKind | undefined {
  return panelKinds.find((known) => known.kind === kind);
}

/** Returns the kinds that show a topic. */
export function kindsFor({ messageType }: ViewerTopic): readonly PanelKind[] {
  return panelKinds.filter(({ accepts }) => accepts(messageType));
}

export function panelFor({ kind, isWide }: PanelDefinition, { recording, name }: ViewerTopic): Panel {
  return { kind, isWide, series: [{ recording, topic: name, fields: [] }] };
}

/** Returns the first layout for topics: of each kind, those that rank highest; a rank of 0 is none. */
export function defaultLayout(topics: readonly ViewerTopic[], kinds: readonly PanelDefinition[] = panelKinds): Panel[] {
  const filled = topics.filter(({ count }) => count !== 0);
  const panels = kinds.flatMap((kind) => {
    const { rank, most } = kind.byDefault;
    const ranked = filled.filter((topic) => kind.accepts(topic.messageType) && rank(topic) > 0).toSorted((a, b) => rank(b) - rank(a));
    const distinct = [...new Map(ranked.toReversed().map((topic) => [topic.name, topic])).values()].toReversed();
    return distinct.slice(0, most).map((topic) => panelFor(kind, topic));
  });
  return withoutGap(panels);
}

/** Returns the panels with the first wide one in the second row, in sight; one that would stand alone in its row becomes wide. */
function withoutGap(panels: Panel[]): Panel[] {
  const sorted = withWideInSight(panels);
  let column = 0;
  return sorted.map((panel, place) => {
    const isLastOfRow = sorted[place + 1]?.isWide !== false;
    const isAlone = !panel.isWide && column === 0 && isLastOfRow;
    column = panel.isWide || isAlone || column === 1 ? 0 : 1;
    return isAlone ? { ...panel, isWide: true } : panel;
  });
}

function withWideInSight(panels: Panel[]): Panel[] {
  const firstWide = panels.findIndex(({ isWide }) => isWide);
  if (firstWide < 1) return panels;
  const others = panels.toSpliced(firstWide, 1);
  const narrow = others.findIndex(({ isWide }, place) => isWide || place === 2);
  return others.toSpliced(narrow < 0 ? others.length : narrow, 0, ...panels.slice(firstWide, firstWide + 1));
}
