// Validation of metadata in forms, by the same rules as the server's.
// The server decides; what cannot be checked here (patterns in Rust's syntax) is left to it.
import type { FieldProblem } from "@/api/problem";
import type { MetadataField, MetadataFields } from "@/api/types";
import { texts } from "@/texts/metadata";

export type Values = Readonly<Record<string, unknown>>;

export interface Place {
  readonly latitude?: number | null;
  readonly longitude?: number | null;
  readonly altitude?: number | null;
  readonly name?: string | null;
}

type Validator = (value: unknown, field: MetadataField) => string | null;

const DATE = /^\d{4}-\d{2}-\d{2}([T ]\d{2}:\d{2}(:\d{2}(\.\d+)?)?\s?(Z|[+-]\d{2}:?\d{2})?)?$/i;

/** Returns whether a field was left empty. */
export function isEmpty(value: unknown): boolean {
  return value === undefined || value === null || value === "";
}

function validateText(value: unknown, field: MetadataField): string | null {
  if (typeof value !== "string") return texts.wantsText;
  if (typeof field.pattern !== "string") return null;
  try {
    return new RegExp(`^(?:${field.pattern})$`, "u").test(value) ? null : texts.wantsPattern(field.pattern);
  } catch (thrown) {
    if (thrown instanceof SyntaxError) return null; // Rust syntax that JavaScript lacks: the server validates
    throw thrown;
  }
}

function validateDate(value: unknown): string | null {
  const isDate = typeof value === "string" && DATE.test(value.trim()) && !Number.isNaN(Date.parse(value.trim().slice(0, 10)));
  return isDate ? null : texts.wantsDate;
}

function validateLink(value: unknown): string | null {
  const isLink = typeof value === "string" && /^https?:\/\//i.test(value) && URL.canParse(value);
  return isLink ? null : texts.wantsLink;
}

function validatePlace(value: unknown): string | null {
  if (typeof value === "string") return null;
  if (typeof value !== "object" || value === null) return texts.wantsPlace;
  const { latitude, longitude } = value as Place;
  if (typeof latitude !== "number" || Math.abs(latitude) > 90) return texts.wantsLatitude;
  return typeof longitude !== "number" || Math.abs(longitude) > 180 ? texts.wantsLongitude : null;
}

const VALIDATORS: Readonly<Record<MetadataField["type"], Validator>> = {
  string: validateText,
  number: (value, field) => (typeof value === "number" && Number.isFinite(value) ? null : texts.wantsNumber(field.unit ?? "")),
  boolean: (value) => (typeof value === "boolean" ? null : texts.wantsBoolean),
  date: validateDate,
  link: validateLink,
  location: validatePlace,
  choice: (value, field) => ((field.choices ?? []).some((item) => item === value) ? null : texts.wantsChoice),
};

/** Returns the error of one value; null if it is valid. */
export function validateField(field: MetadataField, value: unknown): string | null {
  if (!isEmpty(value)) return VALIDATORS[field.type](value, field);
  return field.required && isEmpty(field.default) ? texts.required : null;
}

/** Returns all that is wrong with a form. */
export function validateValues(fields: MetadataFields, values: Values): FieldProblem[] {
  return fields.fields.flatMap((field) => {
    const message = validateField(field, values[field.name]);
    return message === null ? [] : [{ field: field.name, message }];
  });
}

/** Values of an earlier mission as initial values of a form. They count only after they were confirmed or changed. */
export interface Carried {
  /** What the earlier mission is called. */
  readonly from: string;
  readonly values: Values;
}

/** Returns the initial values of a form: own values, and unconfirmed values of an earlier mission. */
export function beginning(values: Values, carried: Carried): { values: Values; unconfirmed: ReadonlySet<string> } {
  return { values: { ...values, ...carried.values }, unconfirmed: new Set(Object.keys(carried.values)) };
}

/** Returns the names of the values that no field declares, in their order. */
export function undeclared(fields: MetadataFields, values: Values): string[] {
  const declared = new Set(fields.fields.map((field) => field.name));
  return Object.keys(values).filter((name) => !declared.has(name));
}

/** Returns the changes between two sets of values; null removes a value. */
export function changes(before: Values, after: Values): Record<string, unknown> {
  const filled: Record<string, unknown> = {};
  for (const name of new Set([...Object.keys(before), ...Object.keys(after)])) {
    const [was, is] = [before[name], after[name]];
    if (isEmpty(is)) {
      if (!isEmpty(was)) filled[name] = null;
    } else if (JSON.stringify(was) !== JSON.stringify(is)) filled[name] = is;
  }
  return filled;
}

/** Returns a value as it is read: a place by its name or its degrees, lists and mappings as JSON. */
export function shownValue(value: unknown, unit?: string | null): string {
  if (isEmpty(value)) return texts.empty;
  if (typeof value === "boolean") return value ? texts.yes : texts.no;
  if (typeof value === "number") return unit ? `${value} ${unit}` : String(value);
  if (typeof value === "string") return value;
  const place = value as Place;
  if (typeof place.latitude !== "number" || typeof place.longitude !== "number") return JSON.stringify(value);
  const degrees = texts.degrees(place.latitude, place.longitude);
  return place.name ? `${place.name} (${degrees})` : degrees;
}
