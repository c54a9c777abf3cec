/** The texts that name curves which are computed from the fields of messages.
 *
 * A path names a field. `norm(PATH)` is the length of a vector, `derivative(PATH)` the change per second since the
 * previous message, and `difference(PATH,PATH)` the first field minus the second.
 */

export type DerivationName = "norm" | "derivative" | "difference";

export interface Derivation {
  readonly name: DerivationName;
  /** Paths of fields, or what else it is computed from. */
  readonly parts: readonly string[];
}

const CALL = /^(norm|derivative|difference)\((.*)\)$/s;
/** What separates, and what escapes it. A percent sign would be escaped again by an address. */
const SPECIAL = /[!,;]/g;
const ESCAPED = /!([0-9a-f]{2})/g;

export function escaped(text: string): string {
  return text.replaceAll(SPECIAL, (mark) => `!${mark.charCodeAt(0).toString(16).padStart(2, "0")}`);
}

export function unescaped(text: string): string {
  return text.replaceAll(ESCAPED, (_, code: string) => String.fromCharCode(Number.parseInt(code, 16)));
}

export function derivationText({ name, parts }: Derivation): string {
  return `${name}(${parts.map(escaped).join(",")})`;
}

/** Returns the derivation that a text names; null for the path of a field, which never contains such a parenthesis. */
export function derivationOf(text: string): Derivation | null {
  const match = CALL.exec(text);
  if (match === null) return null;
  const [, name, parts = ""] = match;
  return { name: name as DerivationName, parts: parts.split(",").map(unescaped) };
}
