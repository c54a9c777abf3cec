// The projects that anybody may see. Whoever is signed in sees more in the same list, so what is not public is left out.
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import { type Rows, usePages } from "@/api/pages";
import type { Project } from "@/api/types";

const PAGE = 100;

export function usePublicProjects(text: () => string): Rows<Project> {
  const found = usePages<Project>(() => keys.projects({ public: text() }), (cursor, signal) => {
    const query = { limit: PAGE, ...(text() !== "" && { text: text() }), ...(cursor !== undefined && { cursor }) };
    return call(api.GET("/api/v1/projects", { params: { query }, signal }));
  });
  return { ...found, rows: computed(() => found.rows.value.filter((project) => project.is_public)) };
}
