// The panels of the viewer and what each shows, as the address writes them.
import { escaped, unescaped } from "@/recordings/curves/derivation_text";

/** A topic of a recording, and the fields of it that are shown. */
export interface Series {
  /** `SourceRecording.key`. */
  readonly recording: string;
  readonly topic: string;
  readonly fields: readonly string[];
}

export interface Panel {
  /** The name of its definition. */
  readonly kind: string;
  readonly series: readonly Series[];
  /** Whether it is as wide as the page. */
  readonly isWide: boolean;
  /** Whether times are those of the headers of messages; log times if absent. */
  readonly isHeaderTime?: boolean;
}

export const MAX_PANELS = 16;
const WIDE = "*";
const HEADER_TIME = "@header";

/** Returns a panel as text: `plot*:04cf00a6@/imu,linear_acceleration.x;04cf00a6@/odom`. */
export function panelText({ kind, isWide, isHeaderTime, series }: Panel): string {
  const parts = series.map(({ recording, topic, fields }) => [`${recording}@${escaped(topic)}`, ...fields.map(escaped)].join(","));
  return `${kind}${isWide ? WIDE : ""}${isHeaderTime === true ? HEADER_TIME : ""}:${parts.join(";")}`;
}

/** Returns the panel that a text describes; null where it describes none. */
export function panelOf(text: string): Panel | null {
  const match = /^([a-z]+)(\*?)(@header)?:(.+)$/s.exec(text);
  if (match === null) return null;
  const [, kind = "", wide, time, rest = ""] = match;
  const series: Series[] = [];
  for (const part of rest.split(";")) {
    const [source = "", ...fields] = part.split(",");
    const at = source.indexOf("@");
    if (at < 1) return null;
    series.push({ recording: source.slice(0, at), topic: unescaped(source.slice(at + 1)), fields: fields.map(unescaped) });
  }
  return { kind, isWide: wide === WIDE, series, ...(time === HEADER_TIME ? { isHeaderTime: true } : {}) };
}

/** Returns the panels of an address; what describes no panel is left out. */
export function panelsOf(texts: readonly string[]): Panel[] {
  return texts.slice(0, MAX_PANELS).flatMap((text) => panelOf(text) ?? []);
}

/** Returns the panels with one moved by so many places. */
export function moved(panels: readonly Panel[], place: number, by: number): readonly Panel[] {
  const target = place + by;
  const panel = panels[place];
  if (panel === undefined || target < 0 || target >= panels.length) return panels;
  return panels.toSpliced(place, 1).toSpliced(target, 0, panel);
}

/** Returns the log time of a text; null where it is none. */
export function timeOf(text: string): bigint | null {
  return /^\d{1,19}$/.test(text) ? BigInt(text) : null;
}
