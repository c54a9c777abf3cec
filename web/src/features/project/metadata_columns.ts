// The declared metadata of a project as columns of its list of missions, and as comparisons that narrow the list.
import type { MetadataField, Mission } from "@/api/types";
import type { Column } from "@/components/table";
import { texts } from "@/texts/project";

const PREFIX = "meta.";
const SORTS: readonly string[] = ["name", "-name", "created", "-created", "start", "-start"];
/** Columns of fields that are shown until somebody chooses. */
const USUAL = 2;

/** Returns an order as the server knows it, whatever stands in the address. */
export function sortOf(text: string): string {
  return SORTS.includes(text) || /^-?meta\.[A-Za-z][\w.]*$/.test(text) ? text : "-start";
}

/** Returns a value of metadata as one line of text. */
export function valueText(value: unknown, unit = ""): string {
  if (value === undefined || value === null) return "";
  if (typeof value === "boolean") return value ? texts.missions.yes : texts.missions.no;
  if (Array.isArray(value)) return value.map((each) => valueText(each)).join(", ");
  if (typeof value === "object") {
    const { name, latitude, longitude } = value as Record<string, unknown>;
    if (typeof name === "string" && name !== "") return name;
    if (typeof latitude === "number" && typeof longitude === "number") return `${latitude}, ${longitude}`;
    return JSON.stringify(value);
  }
  const text = typeof value === "number" || typeof value === "string" ? String(value) : "";
  return unit === "" ? text : `${text} ${unit}`;
}

/** Returns a column for each declared field. */
export function fieldColumns(fields: readonly MetadataField[]): readonly Column<Mission>[] {
  return fields.map((field) => ({
    key: PREFIX + field.name,
    title: field.name,
    sort: PREFIX + field.name,
    width: "minmax(104px, 1fr)",
    from: "tablet" as const,
    ...(field.type === "number" && { align: "right" as const }),
    text: (mission: Mission) => valueText(mission.metadata[field.name], field.type === "number" ? (field.unit ?? "") : ""),
  }));
}

/** Returns the keys of the columns that are shown until somebody chooses: the first fields, required ones before others. */
export function usualFields(fields: readonly MetadataField[]): readonly string[] {
  const [required, optional] = [fields.filter((field) => field.required), fields.filter((field) => !field.required)];
  return [...required, ...optional].slice(0, USUAL).map((field) => PREFIX + field.name);
}

/** What a field can be compared by. The first is the usual one. */
export function operatorsOf(type: MetadataField["type"]): readonly string[] {
  if (type === "number" || type === "date") return type === "date" ? [">=", "<=", "="] : ["=", ">=", "<="];
  if (type === "boolean" || type === "choice") return ["=", "!="];
  return type === "location" ? ["~"] : ["~", "=", "!="]; // a place is a name and coordinates, and equals no text
}

/** Returns a comparison as the server reads it: text stays text, also where it looks like a number. */
export function comparison(field: MetadataField, operator: string, value: string): string {
  if (operator === "~") return `${field.name}~*${value}*`;
  const isText = field.type === "string" || field.type === "choice" || field.type === "link";
  return `${field.name}${operator}${isText ? `"${value}"` : value}`;
}
