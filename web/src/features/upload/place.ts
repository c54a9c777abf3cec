// Where files go: a project and a mission that are there, or made for it. What was typed stays until it is sent.
import { keepPreviousData, useQuery } from "@tanstack/vue-query";
import { computed, type ComputedRef, reactive, type Ref, ref, watch } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import { type FieldProblem, type Problem, toProblem } from "@/api/problem";
import type { Mission, MetadataFields, Page, Project } from "@/api/types";
import { judge, type Values } from "@/components/metadata";
import { texts } from "@/texts/upload";
import type { MissionPlace } from "./engine/nouns";

const LISTED = 200;
const NEW = "new";

/** What is typed. `new` stands for what is to be made. */
export interface PlaceForm {
  projectId: string;
  projectName: string;
  missionId: string;
  missionName: string;
  values: Values;
}

export interface PlaceChoice {
  readonly form: PlaceForm;
  readonly findProject: Ref<string>;
  readonly findMission: Ref<string>;
  readonly projects: ComputedRef<Page<Project> | undefined>;
  readonly missions: ComputedRef<Page<Mission> | undefined>;
  readonly fields: ComputedRef<MetadataFields>;
  readonly prefilledFrom: ComputedRef<string>;
  /** Whether what is wrong is said; once one has tried to go on. */
  readonly isShown: Ref<boolean>;
  readonly problem: Ref<Problem | null>;
  readonly metadataProblems: ComputedRef<readonly FieldProblem[]>;
  readonly wrong: ComputedRef<Readonly<Partial<Record<keyof PlaceForm, string>>>>;
  /** Make what is to be made, and return where files go; null where something is wrong with the form. */
  readonly settle: () => Promise<MissionPlace | null>;
}

const form = reactive<PlaceForm>({ projectId: "", projectName: "", missionId: "", missionName: "", values: {} });

const NO_FIELDS: MetadataFields = { fields: [], undeclared: "accept" };

export function usePlace(): PlaceChoice {
  const [findProject, findMission, isShown, problem] = [ref(""), ref(""), ref(false), ref<Problem | null>(null)];
  const isThere = computed(() => form.projectId !== "" && form.projectId !== NEW);

  const projects = useQuery({
    queryKey: computed(() => keys.projects({ upload: true, text: findProject.value })),
    queryFn: ({ signal }) => {
      const query = { sort: "name", limit: LISTED, text: findProject.value || null } as const;
      return call<Page<Project>>(api.GET("/api/v1/projects", { params: { query }, signal }));
    },
    placeholderData: keepPreviousData,
  });
  const missions = useQuery({
    queryKey: computed(() => keys.missions({ upload: true, project: form.projectId, text: findMission.value })),
    queryFn: ({ signal }) => {
      const query = { project_id: form.projectId, sort: "-created", limit: LISTED, text: findMission.value || null } as const;
      return call<Page<Mission>>(api.GET("/api/v1/missions", { params: { query }, signal }));
    },
    enabled: isThere,
    placeholderData: keepPreviousData,
  });
  const template = useQuery({
    queryKey: computed(() => keys.template(form.projectId)),
    queryFn: ({ signal }) => {
      const path = { project_id: form.projectId };
      return call(api.GET("/api/v1/projects/{project_id}/template", { params: { path }, signal }));
    },
    enabled: isThere,
  });
  const fields = computed(() => (isThere.value ? template.data.value?.fields : undefined) ?? NO_FIELDS);

  watch(() => form.projectId, (now, before) => {
    if (before !== "") Object.assign(form, { missionId: now === NEW ? NEW : "", values: {} });
    isShown.value = false;
    problem.value = null;
  });
  watch(template.data, (told) => {
    if (told !== undefined && Object.keys(form.values).length === 0) form.values = { ...told.values };
  }, { immediate: true });

  const wrong = computed(() => {
    const found: Partial<Record<keyof PlaceForm, string>> = {};
    if (!isShown.value) return found;
    if (form.projectId === "") found.projectId = texts.place.needsChoice;
    if (form.projectId === NEW && form.projectName.trim() === "") found.projectName = texts.place.needsName;
    if (form.missionId === "") found.missionId = texts.place.needsChoice;
    if (form.missionId === NEW && form.missionName.trim() === "") found.missionName = texts.place.needsName;
    return found;
  });

  async function projectToUse(): Promise<{ readonly id: string; readonly name: string }> {
    if (form.projectId !== NEW) return { id: form.projectId, name: projects.data.value?.items.find(({ id }) => id === form.projectId)?.name ?? "" };
    const made = await call(api.POST("/api/v1/projects", { body: { name: form.projectName.trim(), description: "" } }));
    Object.assign(form, { projectId: made.id, projectName: "", missionId: NEW }); // made once, whatever follows
    await projects.refetch();
    return made;
  }

  async function missionToUse(project: { readonly id: string; readonly name: string }): Promise<MissionPlace> {
    const there = missions.data.value?.items.find(({ id }) => id === form.missionId);
    const at = { projectId: project.id, projectName: project.name };
    if (form.missionId !== NEW) return { id: form.missionId, name: there?.name ?? "", ...at };
    const metadata = Object.fromEntries(Object.entries(form.values).filter(([, value]) => value !== null && value !== ""));
    const body = { name: form.missionName.trim(), metadata, notes: "" };
    const path = { project_id: project.id };
    const { id, name } = await call(api.POST("/api/v1/projects/{project_id}/missions", { params: { path }, body }));
    Object.assign(form, { missionId: id, missionName: "", values: {} });
    return { id, name, ...at };
  }

  async function settle(): Promise<MissionPlace | null> {
    isShown.value = true;
    problem.value = null;
    const isFormGood = form.missionId !== NEW || judge(fields.value, form.values).length === 0;
    if (Object.keys(wrong.value).length > 0 || !isFormGood) return null;
    try {
      return await missionToUse(await projectToUse());
    } catch (thrown) {
      problem.value = toProblem(thrown);
      return null;
    }
  }

  return {
    form, findProject, findMission, fields, isShown, problem, wrong, settle,
    projects: computed(() => projects.data.value),
    missions: computed(() => missions.data.value),
    prefilledFrom: computed(() => template.data.value?.prefilled_from?.name ?? ""),
    metadataProblems: computed(() => problem.value?.fields ?? []),
  };
}
