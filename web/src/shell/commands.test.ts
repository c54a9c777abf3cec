import { describe, expect, it } from "vitest";
import { commandsFor, matches, placesFor, searchCommand } from "./commands";

const ADMIN = { isSignedIn: true, isAdmin: true };

describe("the palette", () => {
  it("finds by letters in their order", () => {
    expect(matches("Projects", "pjc")).toBe(true);
    expect(matches("Projects", "cjp")).toBe(false);
    expect(matches("Public projects", "pub pro")).toBe(true);
  });
  it("offers what one may go to", () => {
    expect(commandsFor("", ADMIN).map((item) => item.label)).toContain("Admin");
    expect(commandsFor("", { isSignedIn: true, isAdmin: false }).map((item) => item.label)).not.toContain("Admin");
    expect(commandsFor("", { isSignedIn: false, isAdmin: false }).map((item) => item.label)).toEqual(["Public projects", "Search"]);
  });
  it("shows the actions in the menu of everybody who signed in", () => {
    expect(placesFor(true, false).map((item) => item.label)).toContain("Actions");
  });
  it("acts, too", () => expect(commandsFor("dark", ADMIN).map((item) => item.id)).toEqual(["theme dark"]));
  it("searches for whatever was typed", () => {
    expect(searchCommand("a & b")).toMatchObject({ to: { name: "search", query: { q: "a & b" } } });
  });
});
