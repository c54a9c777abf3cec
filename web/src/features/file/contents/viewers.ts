// The viewers of files: all components in `viewers/`.
import type { Component } from "vue";
import type { Content, FileViewer } from "./content";

export interface ListedViewer extends FileViewer {
  /** Has the props `ViewerProps`. */
  readonly component: Component;
}

const modules = import.meta.glob<{ readonly default: Component; readonly viewer: FileViewer }>("./viewers/*.vue", { eager: true });
const viewers: readonly ListedViewer[] = Object.values(modules).map(({ default: component, viewer }) => ({ ...viewer, component }));

/** Returns the viewers that can show a file, the best one first. */
export function viewersOf(content: Content): readonly ListedViewer[] {
  const ranked = viewers.map((viewer) => ({ viewer, rank: viewer.rank(content) }));
  return ranked.filter(({ rank }) => rank > 0).sort((a, b) => b.rank - a.rank).map(({ viewer }) => viewer);
}
