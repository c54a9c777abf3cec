// The destination form of an upload: existing or new project and mission. Input is kept until it is sent.
import { keepPreviousData, useQuery } from "@tanstack/vue-query";
import { computed, onScopeDispose, reactive, ref, shallowReactive, watch, type ComputedRef, type Ref } from "vue";
import { useRoute } from "vue-router";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import { toProblem, type Problem } from "@/api/problem";
import type { MetadataFields, Mission, Page, Project } from "@/api/types";
import { beginning, validateValues, type Values } from "@/components/metadata";
import { carriedBy, useTemplate } from "@/features/project/fields";
import { texts } from "@/texts/upload";
import type { MissionPlace } from "./engine/types";

const LISTED = 200;
const NEW = "new";

/** The values of the form. `new` means to create one. */
export interface PlaceForm {
  projectId: string;
  projectName: string;
  missionId: string;
  missionName: string;
  values: Values;
  /** Fields with unconfirmed values of an earlier mission. */
  unconfirmed: ReadonlySet<string>;
}

interface Named {
  readonly id: string;
  readonly name: string;
}

interface Options {
  readonly items: readonly Named[];
  readonly hasMore: boolean;
}

export interface PlaceChoice {
  readonly form: PlaceForm;
  readonly find: { project: string; mission: string };
  /** Undefined while they are not known. */
  readonly projects: ComputedRef<Options | undefined>;
  readonly missions: ComputedRef<Options>;
  readonly fields: ComputedRef<MetadataFields>;
  readonly carriedFrom: ComputedRef<string>;
  /** Whether errors are shown: after the first attempt to continue. */
  readonly isShown: Ref<boolean>;
  readonly problem: Ref<Problem | null>;
  readonly wrong: ComputedRef<Readonly<Partial<Record<keyof PlaceForm, string>>>>;
  readonly pickProject: (id: string) => void;
  /** Create the project and mission if needed, and return the destination; null if the form has errors. */
  readonly createDestination: () => Promise<MissionPlace | null>;
}

const form = reactive<PlaceForm>({ projectId: "", projectName: "", missionId: "", missionName: "", values: {}, unconfirmed: new Set() });

const NO_FIELDS: MetadataFields = { fields: [], undeclared: "accept" };

/** What the address named, which may not be among those listed. */
const known = shallowReactive<{ project: Named | null; mission: Named | null }>({ project: null, mission: null });

/** Choose what the address names: a mission, or a project for a new one. `signal`: the page was left, and chooses nothing. */
async function preselect(missionId: string, projectId: string, signal: AbortSignal): Promise<void> {
  if (missionId !== "") {
    const mission = await call<Mission>(api.GET("/api/v1/missions/{mission_id}", { params: { path: { mission_id: missionId } }, signal }));
    choose(mission.project, mission);
  } else if (projectId !== "") {
    const project = await call<Project>(api.GET("/api/v1/projects/{project_id}", { params: { path: { project_id: projectId } }, signal }));
    choose(project, null);
  }
}

function choose(project: Named, mission: Named | null): void {
  Object.assign(known, { project, mission });
  Object.assign(form, { projectId: project.id, missionId: mission?.id ?? NEW, missionName: "", values: {}, unconfirmed: new Set() });
}

function withKnown(named: Named | null, listed: readonly Named[]): readonly Named[] {
  return named === null || listed.some(({ id }) => id === named.id) ? listed : [named, ...listed];
}

function nameOf(options: readonly Named[], chosenId: string): string {
  return options.find(({ id }) => id === chosenId)?.name ?? "";
}

export function usePlace(): PlaceChoice {
  const find = reactive({ project: "", mission: "" });
  const isShown = ref(false);
  const problem = ref<Problem | null>(null);
  const address = useRoute().query;
  const [mission, project] = [address.mission, address.project].map((item) => (typeof item === "string" ? item : ""));
  const left = new AbortController();
  onScopeDispose(() => left.abort());
  const isPreselected = preselect(mission ?? "", project ?? "", left.signal).catch((thrown: unknown) => {
    problem.value = toProblem(thrown);
  });
  const isExistingProject = computed(() => form.projectId !== "" && form.projectId !== NEW);

  const projects = useQuery({
    queryKey: computed(() => keys.projects({ upload: true, text: find.project })),
    queryFn: ({ signal }) => {
      const query = { sort: "name", limit: LISTED, text: find.project || null } as const;
      return call<Page<Project>>(api.GET("/api/v1/projects", { params: { query }, signal }));
    },
    placeholderData: keepPreviousData,
  });
  const missions = useQuery({
    queryKey: computed(() => keys.missions({ upload: true, project: form.projectId, text: find.mission })),
    queryFn: ({ signal }) => {
      const query = { project_id: form.projectId, sort: "-created", limit: LISTED, text: find.mission || null } as const;
      return call<Page<Mission>>(api.GET("/api/v1/missions", { params: { query }, signal }));
    },
    enabled: isExistingProject,
    placeholderData: keepPreviousData,
  });
  const template = useTemplate(() => (isExistingProject.value ? form.projectId : ""));
  const writable = computed(() => projects.data.value?.items.filter(({ right }) => right !== "READ") ?? []);
  const projectOptions = computed(() => withKnown(known.project, writable.value));
  const missionOptions = computed(() => withKnown(known.mission, missions.data.value?.items ?? []));
  const fields = computed(() => (isExistingProject.value ? template.data.value?.fields : undefined) ?? NO_FIELDS);

  watch([template.data, () => form.missionId], ([loaded]) => {
    const isUntouched = form.missionId === NEW && Object.keys(form.values).length === 0;
    if (loaded !== undefined && isUntouched) Object.assign(form, beginning(loaded.values, carriedBy(loaded)));
  }, { immediate: true });

  /** Choose another project; this resets the mission. */
  function pickProject(id: string): void {
    Object.assign(form, { projectId: id, missionId: id === NEW ? NEW : "", values: {}, unconfirmed: new Set() });
    isShown.value = false;
    problem.value = null;
  }

  const wrong = computed(() => {
    const errors: Partial<Record<keyof PlaceForm, string>> = {};
    if (!isShown.value) return errors;
    if (form.projectId === "") errors.projectId = texts.place.needsChoice;
    if (form.projectId === NEW && form.projectName.trim() === "") errors.projectName = texts.place.needsName;
    if (form.missionId === "") errors.missionId = texts.place.needsChoice;
    if (form.missionId === NEW && form.missionName.trim() === "") errors.missionName = texts.place.needsName;
    return errors;
  });

  async function projectToUse(): Promise<Named> {
    if (form.projectId !== NEW) return { id: form.projectId, name: nameOf(projectOptions.value, form.projectId) };
    const made = await call(api.POST("/api/v1/projects", { body: { name: form.projectName.trim(), description: "" } }));
    known.project = made;
    Object.assign(form, { projectId: made.id, projectName: "" }); // made once, whatever follows
    return made;
  }

  async function missionToUse(project: Named): Promise<MissionPlace> {
    const at = { projectId: project.id, projectName: project.name };
    if (form.missionId !== NEW) return { id: form.missionId, name: nameOf(missionOptions.value, form.missionId), ...at };
    const metadata = Object.fromEntries(Object.entries(form.values).filter(([, value]) => value !== null && value !== ""));
    const body = { name: form.missionName.trim(), metadata, notes: "" };
    const path = { project_id: project.id };
    const made = await call(api.POST("/api/v1/projects/{project_id}/missions", { params: { path }, body }));
    choose(project, made);
    return { id: made.id, name: made.name, ...at };
  }

  async function createDestination(): Promise<MissionPlace | null> {
    await isPreselected;
    isShown.value = true;
    problem.value = null;
    const isFormGood = form.missionId !== NEW || (validateValues(fields.value, form.values).length === 0 && form.unconfirmed.size === 0);
    if (Object.keys(wrong.value).length > 0 || !isFormGood) return null;
    try {
      return await missionToUse(await projectToUse());
    } catch (thrown) {
      problem.value = toProblem(thrown);
      return null;
    }
  }

  return {
    form, find, fields, isShown, problem, wrong, pickProject, createDestination,
    projects: computed(() => {
      const loaded = projects.data.value;
      return loaded && { items: projectOptions.value, hasMore: loaded.next != null };
    }),
    missions: computed(() => ({ items: missionOptions.value, hasMore: missions.data.value?.next != null })),
    carriedFrom: computed(() => carriedBy(template.data.value).from),
  };
}
