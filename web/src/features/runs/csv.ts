// A table that a run left as CSV (RFC 4180), as far as it is shown.

/** Returns the rows of a text, the first `most` of them, and how many there are. */
export function rowsOf(text: string, most: number): { readonly rows: readonly (readonly string[])[]; readonly count: number } {
  const rows: string[][] = [];
  let row: string[] = [];
  let count = 0;
  let at = text.startsWith("\ufeff") ? 1 : 0;

  function field(): string {
    if (text[at] !== '"') {
      const from = at;
      while (at < text.length && text[at] !== "," && text[at] !== "\n" && text[at] !== "\r") at += 1;
      return text.slice(from, at);
    }
    let value = "";
    at += 1;
    while (at < text.length) {
      const end = text.indexOf('"', at);
      value += text.slice(at, end < 0 ? text.length : end);
      at = end < 0 ? text.length : end + 1;
      if (text[at] !== '"') break;
      value += '"';
      at += 1;
    }
    return value;
  }

  while (at < text.length) {
    row.push(field());
    if (text[at] === ",") {
      at += 1;
      if (at < text.length) continue;
      row.push("");
    }
    if (text[at] === "\r") at += 1;
    if (text[at] === "\n") at += 1;
    count += 1;
    if (rows.length < most) rows.push(row);
    row = [];
  }
  return { rows, count };
}
