// The upload protocol over HTTP, as the page's session. Each question is asked once; nothing heard is `null`.

import createClient from "openapi-fetch";
import type { components, paths } from "@/api/schema";
import type { Answer, UploadApi } from "./api";
import type { ProblemDocument } from "./types";

type Schemas = components["schemas"];

export function httpApi(origin: string): UploadApi {
  const api = createClient<paths>({ baseUrl: origin });
  return {
    begin: async (missionId, files) => {
      const asked = api.POST("/api/v1/missions/{mission_id}/uploads", {
        params: { path: { mission_id: missionId } },
        body: { files: [...files] },
      });
      return answered(asked, (data) => (data as Schemas["UploadDecisions"]).items);
    },
    sign: async (parts) => {
      const asked = api.POST("/api/v1/uploads/parts", { body: { parts: [...parts] } });
      return answered(asked, (data) => (data as Schemas["SignedParts"]).items);
    },
    complete: async (finishes) => {
      const asked = api.POST("/api/v1/uploads/complete", { body: { uploads: [...finishes] } });
      return answered(asked, (data) => (data as Schemas["UploadOutcomes"]).items);
    },
    abort: async (uploadId) => {
      const asked = api.DELETE("/api/v1/uploads/{upload_id}", { params: { path: { upload_id: uploadId } } });
      return answered(asked, () => null);
    },
  };
}

interface Told {
  readonly data?: unknown;
  readonly error?: unknown;
  readonly response: Response;
}

async function answered<T>(asked: Promise<Told>, read: (data: unknown) => T): Promise<Answer<T>> {
  let told: Told;
  try {
    told = await asked;
  } catch {
    return null; // no connection, or an answer that broke off
  }
  const { data, error, response } = told;
  if (response.ok) return { ok: read(data) };
  if (isProblem(error)) return { problem: error };
  if (response.status >= 502 && response.status <= 504) return null;
  const detail = `the answer has status ${response.status}, and says nothing that this page understands`;
  return { problem: { code: "internal_error", detail, status: response.status, title: "not understood", type: "about:blank" } };
}

function isProblem(value: unknown): value is ProblemDocument {
  return typeof value === "object" && value !== null && "code" in value && "detail" in value;
}
