// The fields of a project while somebody changes them: as they are typed, judged, and as they are sent.
import type { MetadataField, MetadataFields } from "@/api/types";
import { texts as all } from "@/texts/project";

const texts = all.fields;

export interface Draft {
  /** Stays when fields change their order or name. */
  readonly key: number;
  name: string;
  type: MetadataField["type"];
  required: boolean;
  unit: string;
  choices: string;
  pattern: string;
  description: string;
  /** Of a field that was there before: what no form here shows. */
  readonly fallback: MetadataField["default"];
  readonly was: MetadataField["type"] | null;
}

export const TYPES = ["string", "number", "boolean", "date", "location", "link", "choice"] as const;
const NAME = /^[A-Za-z][A-Za-z0-9_]{0,63}$/;
let last = 0;

/** Returns fields as they are typed. */
export function draftsOf({ fields }: MetadataFields): Draft[] {
  return fields.map((field) => ({
    key: (last += 1),
    name: field.name,
    type: field.type,
    required: field.required,
    unit: field.unit ?? "",
    choices: (field.choices ?? []).join("\n"),
    pattern: field.pattern ?? "",
    description: field.description,
    fallback: field.default,
    was: field.type,
  }));
}

/** Returns a field that nothing is said of yet. */
export function emptyDraft(): Draft {
  return { key: (last += 1), name: "", type: "string", required: false, unit: "", choices: "", pattern: "", description: "", fallback: null, was: null };
}

function choicesOf(draft: Draft): string[] {
  return [...new Set(draft.choices.split("\n").map((each) => each.trim()).filter((each) => each !== ""))];
}

/** Returns what is wrong, by the key of the field and the name of what is typed. */
export function wrongWith(drafts: readonly Draft[]): ReadonlyMap<string, string> {
  const wrong = new Map<string, string>();
  const seen = new Set<string>();
  for (const draft of drafts) {
    const name = draft.name.trim();
    if (name === "") wrong.set(`${draft.key} name`, texts.nameMissing);
    else if (!NAME.test(name)) wrong.set(`${draft.key} name`, texts.nameWrong);
    else if (seen.has(name.toLowerCase())) wrong.set(`${draft.key} name`, texts.nameTwice);
    seen.add(name.toLowerCase());
    if (draft.type === "choice" && choicesOf(draft).length === 0) wrong.set(`${draft.key} choices`, texts.choicesMissing);
  }
  return wrong;
}

/** Returns fields as the server takes them; what does not belong to a field's type is left out. */
export function fieldsOf(drafts: readonly Draft[], refusesUndeclared: boolean): MetadataFields {
  const fields = drafts.map((draft): MetadataField => ({
    name: draft.name.trim(),
    type: draft.type,
    required: draft.required,
    description: draft.description.trim(),
    ...(draft.type === "number" && draft.unit.trim() !== "" && { unit: draft.unit.trim() }),
    ...(draft.type === "choice" && { choices: choicesOf(draft) }),
    ...(draft.type === "string" && draft.pattern !== "" && { pattern: draft.pattern }),
    ...(draft.type === draft.was && draft.fallback !== null && draft.fallback !== undefined && { default: draft.fallback }),
  }));
  return { fields, undeclared: refusesUndeclared ? "refuse" : "accept" };
}

/** Returns drafts with one moved up or down by a place. */
export function moved(drafts: readonly Draft[], at: number, by: -1 | 1): Draft[] {
  const next = [...drafts];
  const [one, other] = [next[at], next[at + by]];
  if (one !== undefined && other !== undefined) [next[at], next[at + by]] = [other, one];
  return next;
}
