// The metadata fields of a project in the editor and in filters: drafts, validation, and their form in the API.
import type { MetadataField, MetadataFields, Mission } from "@/api/types";
import { texts as projectTexts } from "@/texts/project";
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed, toValue, type MaybeRefOrGetter } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { FieldProblem, Problem } from "@/api/problem";
import type { components } from "@/api/schema";
import type { Carried } from "@/components/metadata";
import type { Column } from "@/components/table";

const texts = projectTexts.fields;

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
  /** Of a field that originalType there before: what no form here shows. */
  readonly fallback: MetadataField["default"];
  readonly originalType: MetadataField["type"] | null;
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
    originalType: field.type,
  }));
}

/** Returns an empty field. */
export function emptyDraft(): Draft {
  return { key: (last += 1), name: "", type: "string", required: false, unit: "", choices: "", pattern: "", description: "", fallback: null, originalType: null };
}

function choicesOf(draft: Draft): string[] {
  return [...new Set(draft.choices.split("\n").map((item) => item.trim()).filter((item) => item !== ""))];
}

/** Returns the errors by field key and input: `3 name`. */
export function validateDrafts(drafts: readonly Draft[]): ReadonlyMap<string, string> {
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
    ...(draft.type === draft.originalType && draft.fallback !== null && draft.fallback !== undefined && { default: draft.fallback }),
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

type MissionCreate = components["schemas"]["MissionCreate"];
type MissionTemplate = components["schemas"]["MissionTemplate"];

export function useCreateMission(projectId: string) {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: (body: MissionCreate) => call(api.POST("/api/v1/projects/{project_id}/missions", { params: { path: { project_id: projectId } }, body })),
    onSuccess: (mission) => {
      queries.setQueryData(keys.mission(mission.id), mission);
      for (const list of ["projects", "missions"]) void queries.invalidateQueries({ queryKey: [list] });
    },
    meta: { showsItself: true },
  });
}

/** Initial values of the next mission of a project, from the latest one. Never cached. */
export function useTemplate(projectId: MaybeRefOrGetter<string>) {
  return useQuery({
    queryKey: computed(() => keys.template(toValue(projectId))),
    queryFn: ({ signal }) => {
      const path = { project_id: toValue(projectId) };
      return call(api.GET("/api/v1/projects/{project_id}/template", { params: { path }, signal }));
    },
    enabled: computed(() => toValue(projectId) !== ""),
    gcTime: 0,
  });
}

/** Returns the values that an earlier mission provides for the next one. */
export function carriedBy(template: MissionTemplate | undefined): Carried {
  return { from: template?.prefilled_from?.name ?? "", values: template?.carried ?? {} };
}

/** The errors of a rejection: of the name, of metadata fields, and whether there are others. */
export interface Refusal {
  readonly name: string;
  readonly metadata: readonly FieldProblem[];
  readonly isElsewhere: boolean;
}

/** Returns the errors of a rejection for a form that shows the fields `shown`. */
export function readRefusal(problem: Problem | null, shown: ReadonlySet<string>): Refusal {
  if (problem === null) return { name: "", metadata: [], isElsewhere: false };
  if (problem.code === "name_taken") return { name: problem.message, metadata: [], isElsewhere: false };
  const ofName = problem.code === "invalid_request" ? problem.fields.find(({ field }) => field === "body.name") : undefined;
  const metadata = problem.code === "metadata_invalid" ? problem.fields : [];
  const beside = metadata.filter(({ field }) => shown.has(field.split(".")[0] ?? "")).length + (ofName === undefined ? 0 : 1);
  return { name: ofName?.message ?? "", metadata, isElsewhere: beside === 0 || beside < problem.fields.length };
}

const PREFIX = "meta.";
const SORTS: readonly string[] = ["name", "-name", "created", "-created", "start", "-start", "verdict", "-verdict"];
/** Field columns shown by default. */
const USUAL = 2;

/** Returns a sort order that the server accepts for any value in the URL. */
export function sortOf(text: string): string {
  return SORTS.includes(text) || /^-?meta\.[A-Za-z][\w.]*$/.test(text) ? text : "-start";
}

/** Returns a value of metadata as one line of text. */
export function valueText(value: unknown, unit = ""): string {
  if (value === undefined || value === null) return "";
  if (typeof value === "boolean") return value ? projectTexts.missions.yes : projectTexts.missions.no;
  if (Array.isArray(value)) return value.map((item) => valueText(item)).join(", ");
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

/** Returns the columns shown by default: the first fields, required ones first. */
export function defaultFields(fields: readonly MetadataField[]): readonly string[] {
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
