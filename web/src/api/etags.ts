// Of which etag a thing was when its editor looked at it: where somebody else came first, they are told.

/** What goes with a change that was made by looking at something. */
export interface Looked {
  readonly etag?: string | undefined;
}

// What this page itself made of an etag: of two forms that stand open, saving one does not outdate the other.
const own = new Map<string, string>();

/** Notes that a change of one's own led from one etag to another. */
export function ledTo(from: string | undefined, to: string | undefined): void {
  if (from === undefined || to === undefined || from === to) return;
  own.delete(to); // it is the newest now, also where it was there before
  own.set(latest(from), to);
}

/** Returns the header by which the server refuses a change to anything but that etag, or what we made of it. */
export function ifStill(etag: string | undefined): { readonly "If-Match"?: string } {
  return etag === undefined ? {} : { "If-Match": `"${latest(etag)}"` };
}

function latest(etag: string): string {
  let at = etag;
  for (let next = own.get(at); next !== undefined; next = own.get(at)) at = next;
  return at;
}
