// Of which edition a thing was when its editor looked at it: where somebody else came first, they are told.

/** What goes with a change that was made by looking at something. */
export interface Looked {
  readonly edition?: string | undefined;
}

// What this page itself made of an edition: of two forms that stand open, saving one does not outdate the other.
const own = new Map<string, string>();

/** Notes that a change of one's own led from one edition to another. */
export function ledTo(from: string | undefined, to: string | undefined): void {
  if (from === undefined || to === undefined || from === to) return;
  own.delete(to); // it is the newest now, also where it was there before
  own.set(latest(from), to);
}

/** Returns the header by which the server refuses a change to anything but that edition, or what we made of it. */
export function ifStill(edition: string | undefined): { readonly "If-Match"?: string } {
  return edition === undefined ? {} : { "If-Match": `"${latest(edition)}"` };
}

function latest(edition: string): string {
  let at = edition;
  for (let next = own.get(at); next !== undefined; next = own.get(at)) at = next;
  return at;
}
