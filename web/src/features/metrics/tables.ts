// Tables of metrics: the query of an address, numbers as the command line writes them, outcomes of a comparison, commands.
import type { Aggregate, Better, MetricTable, TableQuery } from "./queries";
import { quoted, type Commands } from "@/components/commands";

export const AGGREGATES = ["median", "mean", "min", "max", "latest", "count"] as const satisfies readonly Aggregate[];
export const BETTER = ["lower", "higher", "none"] as const satisfies readonly Better[];
export const DEFAULT_COLUMNS = ["action", "version"] as const;
/** Columns that any table can have. */
const COLUMNS = ["action", "version", "topic"] as const;
const DIGITS = 4;
const [MIN_EXPONENT, MAX_EXPONENT] = [-5, 15];

/** What the address of the page says, each as text. */
export interface Address {
  readonly metric: string;
  readonly project: string;
  readonly mission: string;
  readonly rows: string;
  readonly columns: readonly string[];
  readonly aggregate: string;
  readonly better: string;
  readonly query: string;
  readonly where: readonly string[];
  readonly action: string;
  readonly version: string;
  readonly topic: string;
  readonly first: string;
  readonly second: string;
  readonly all: string;
}

/** Returns the query of an address; null as long as no metric is chosen. */
export function queryOf(address: Address): TableQuery | null {
  if (address.metric === "") return null;
  const better = BETTER.find((item) => item === address.better);
  const version = Number(address.version);
  return {
    metric: address.metric,
    rows: address.rows,
    columns: [...address.columns],
    aggregate: AGGREGATES.find((item) => item === address.aggregate) ?? "median",
    ...(better && { better }),
    ...(address.project && { project_id: address.project }),
    ...(address.mission && { mission_id: address.mission }),
    ...(address.query && { query: address.query }),
    ...(address.where.length > 0 && { where: [...address.where] }),
    ...(address.action && { action: address.action }),
    ...(Number.isInteger(version) && version > 0 && { version }),
    ...(address.topic && { topic: address.topic }),
    ...(address.first && address.second && { compare: [address.first, address.second] }),
    ...(address.all === "yes" && { all_rows: true }),
  };
}

/** Returns what can be chosen as columns: what any table can have, what these results differ in, what is chosen. */
export function columnChoices(table: MetricTable | undefined, chosen: readonly string[]): readonly string[] {
  return [...new Set([...COLUMNS, ...(table?.dimensions ?? []).map(({ name }) => name), ...chosen])];
}

/** Returns columns with one more or one less; never none. */
export function toggled(columns: readonly string[], name: string): readonly string[] {
  const others = columns.filter((item) => item !== name);
  if (others.length === columns.length) return [...columns, name];
  return others.length === 0 ? columns : others;
}

/** Returns a number with four significant digits; whole ones of a table of whole numbers as they are. */
export function numberText(value: number, isWhole: boolean): string {
  if (value === 0 || isWhole) return String(value);
  const exponent = Number(value.toExponential(DIGITS - 1).split("e")[1]);
  if (exponent < MIN_EXPONENT || exponent >= MAX_EXPONENT) return value.toExponential(DIGITS - 1);
  return value.toFixed(Math.max(0, DIGITS - 1 - exponent));
}

/** Whether all values of a table are whole numbers. */
export function isWholeTable(table: MetricTable): boolean {
  return table.rows.every(({ cells }) => cells.every(({ value }) => typeof value !== "number" || Number.isSafeInteger(value)));
}

/** Returns a difference with its sign. */
export function differenceText(value: number, isWhole: boolean): string {
  return value > 0 ? `+${numberText(value, isWhole)}` : numberText(value, isWhole).replace("-", "−");
}

export type Outcome = "win" | "loss" | "tie";

/** Returns what a difference means for the second column; null where neither direction is better. */
export function outcomeOf(difference: number, better: Better): Outcome | null {
  if (better === "none") return null;
  if (difference === 0) return "tie";
  return difference < 0 === (better === "lower") ? "win" : "loss";
}

/** Returns the commands that make the same table. Projects and missions are named by their ids. */
export function tableCommands(query: TableQuery): Commands {
  const columns = (query.columns ?? DEFAULT_COLUMNS).join(",");
  const rows = (query.rows ?? "mission").replace(/^metadata\./, "");
  const { compare, where = [] } = query;
  const options: readonly (readonly [string, string | undefined])[] = [
    ["--metric", query.metric], ["--rows", rows], ["--columns", columns], ["--aggregate", query.aggregate], ["--better", query.better ?? undefined],
    ["--project", query.project_id ?? undefined], ["--mission", query.mission_id ?? undefined], ["--query", query.query ?? undefined],
    ...where.map((item) => ["--where", item] as const),
    ["--action", query.action ? query.action + (query.version ? `@${query.version}` : "") : undefined], ["--topic", query.topic ?? undefined],
  ];
  const cli = [
    "klein metrics table",
    ...options.flatMap(([name, value]) => (value === undefined ? [] : [`${name} ${quoted(value)}`])),
    ...(compare && compare.length === 2 ? [`--compare ${compare.map(quoted).join(" ")}`] : []),
    ...(query.all_rows ? ["--all-rows"] : []),
  ].join(" ");
  const keywords: readonly (readonly [string, unknown])[] = [
    ["rows", rows], ["columns", columns.split(",")], ["aggregate", query.aggregate], ["better", query.better], ["project", query.project_id],
    ["mission", query.mission_id], ["query", query.query], ["where", where.length > 0 ? where : undefined], ["action", query.action], ["version", query.version],
    ["topic", query.topic], ["compare", compare],
  ];
  const present = keywords.flatMap(([name, value]) => (value === undefined || value === null ? [] : [`${name}=${JSON.stringify(value)}`]));
  const args = [JSON.stringify(query.metric), ...present, ...(query.all_rows ? ["all_rows=True"] : [])].join(", ");
  return { cli, sdk: `import kleinkram\n\nwith kleinkram.connect() as client:\n    frame = client.metrics.table(${args}).to_pandas()` };
}
