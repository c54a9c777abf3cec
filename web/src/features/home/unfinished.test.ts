import { expect, it } from "vitest";
import { byMission, type UnfinishedUpload } from "./queries";

function upload(mission: string, sent_bytes: number | null, expires_at: string): UnfinishedUpload {
  return {
    id: `${mission}${expires_at}`, mission: { id: mission, name: mission, project: { id: "p", name: "Alps" } }, path: "a.bag",
    size_bytes: 100, sent_bytes, created_at: "2026-11-01T00:00:00Z", expires_at,
  };
}

it("sums what is unfinished by mission", () => {
  const missions = byMission([upload("day", 40, "2026-11-09"), upload("night", null, "2026-11-07"), upload("day", null, "2026-11-08")]);
  expect(missions.map(({ mission, files, sizeBytes, sentBytes, expiresAt }) => [mission.id, files.length, sizeBytes, sentBytes, expiresAt])).toEqual([
    ["day", 2, 200, 40, "2026-11-08"],
    ["night", 1, 100, null, "2026-11-07"],
  ]);
});
