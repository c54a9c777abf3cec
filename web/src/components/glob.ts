// Patterns that the server's filters take.

/** Returns what somebody typed as a pattern: a part of a name finds it, unless they wrote a pattern themselves. */
export function globOf(typed: string): string {
  const text = typed.trim();
  return text === "" || /[*?[]/.test(text) ? text : `*${text}*`;
}
