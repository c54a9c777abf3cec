// Short names of the API's types.
import type { components } from "./schema";

type Schemas = components["schemas"];

export type Service = Schemas["ServiceRead"];
export type Me = Schemas["MeRead"];
export type Project = Schemas["ProjectRead"];
export type Mission = Schemas["MissionRead"];
export type MissionPosition = Schemas["MissionPosition"];
export type File = Schemas["FileRead"];
export type Topic = Schemas["TopicRead"];
export type Recording = Schemas["RecordingRead"];
export type Upload = Schemas["UploadRead"];
export type Person = Schemas["PersonRead"];
export type Group = Schemas["GroupRead"];
export type Member = Schemas["MemberRead"];
export type Grant = Schemas["GrantRead"];
export type Access = Schemas["AccessRead"];
export type Token = Schemas["TokenRead"];
export type Session = Schemas["SessionRead"];
export type Share = Schemas["ShareRead"];
export type AuditEvent = Schemas["AuditRead"];
export type Trashed = Schemas["TrashRead"];
export type Right = Schemas["Right"];
export type BlobState = Schemas["BlobState"];
export type ContentState = Schemas["ContentState"];
export type MetadataField = Schemas["MetadataField"];
export type MetadataFields = Schemas["MetadataFields"];
export type Action = Schemas["ActionRead"];
export type ActionVersion = Schemas["ActionVersionRead"];
export type Definition = Schemas["ActionDefinition"];
export type Parameter = Definition["parameters"][number];
export type Run = Schemas["RunRead"];
export type RunDetail = Schemas["RunDetail"];
export type RunState = Schemas["RunState"];
export type Artifact = Schemas["ArtifactRead"];
export type Verdict = Schemas["Verdict"];
export type CheckStatus = Schemas["CheckStatus"];
export type CellStatus = Schemas["CellStatus"];
export type CheckCounts = Schemas["CheckCounts"];
export type Json = Schemas["JsonValue"];

/** One page of a list; `next` continues it, null at its end. */
export interface Page<Item> {
  readonly items: readonly Item[];
  readonly next?: string | null;
  readonly total?: number | null;
}
