import { describe, expect, it } from "vitest";
import { readRefusal } from "./creating";
import { Problem } from "@/api/problem";

function refused(code: "name_taken" | "invalid_request" | "metadata_invalid" | "forbidden", ...fields: string[]): Problem {
  const problems = fields.map((field) => ({ field, message: `${field} is wrong` }));
  return new Problem(code, 422, "x", "It is refused.", null, { problems });
}

const SHOWN = new Set(["robot", "place"]);

describe("what is said beside each field when a mission is refused", () => {
  it("is nothing before it is", () => {
    expect(readRefusal(null, SHOWN)).toEqual({ name: "", metadata: [], isElsewhere: false });
  });
  it("is what is wrong with the name", () => {
    expect(readRefusal(refused("name_taken"), SHOWN)).toEqual({ name: "It is refused.", metadata: [], isElsewhere: false });
    expect(readRefusal(refused("invalid_request", "body.name"), SHOWN)).toMatchObject({ name: "body.name is wrong", isElsewhere: false });
  });
  it("is what is wrong with the metadata, a part of a place too, and never the name's", () => {
    const said = readRefusal(refused("metadata_invalid", "robot", "place.latitude"), SHOWN);
    expect(said).toMatchObject({ name: "", isElsewhere: false });
    expect(said.metadata.map(({ field }) => field)).toEqual(["robot", "place.latitude"]);
    expect(readRefusal(refused("metadata_invalid", "name"), new Set(["name"]))).toMatchObject({ name: "", isElsewhere: false });
  });
  it("is said above all where no field shows it", () => {
    expect(readRefusal(refused("metadata_invalid", "robot", "surplus"), SHOWN).isElsewhere).toBe(true);
    expect(readRefusal(refused("invalid_request", "body.notes"), SHOWN).isElsewhere).toBe(true);
    expect(readRefusal(refused("forbidden"), SHOWN).isElsewhere).toBe(true);
  });
});
