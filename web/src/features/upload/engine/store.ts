// Client of the object store: a PUT to a signed URL, and the meaning of each response.

import type { SignedPart } from "./types";

/** `called_back`: the upload was paused or cancelled while the bytes were on their way. */
export type Meaning = "taken" | "try_again" | "sign_again" | "gone" | "refused" | "called_back";

export interface PutAnswer {
  readonly meaning: Meaning;
  /** The store's name for what it took. */
  readonly etag: string;
  /** Why it was not taken, in the store's words; "" where nothing was heard. */
  readonly reason: string;
}

export interface Store {
  /** PUT a part; `moved` is called with the bytes sent. */
  put(part: SignedPart, body: Blob, signal: AbortSignal, moved: (sizeBytes: number) => void): Promise<PutAnswer>;
}

// Browsers set these headers and forbid pages to set them.
const BROWSERS_OWN = new Set(["content-length", "host"]);
const STALLED_MS = 60_000;
const GONE = new Set(["NoSuchUpload", "NoSuchKey"]);

/** Return what an answer other than success means, with the store's code for it ("" where it gave none). */
export function meaningOf(status: number, code: string): Meaning {
  if (GONE.has(code)) return "gone";
  if (status === 403) return "sign_again";
  // 404 without the store's own word is that of a proxy which does not reach the store.
  if ([0, 404, 408, 410, 429].includes(status) || status >= 500 || code === "RequestTimeout") return "try_again";
  return "refused";
}

export const realStore: Store = {
  put: (part, body, signal, moved) =>
    new Promise((resolve) => {
      const request = new XMLHttpRequest();
      let sent = 0;
      let watchdog = 0;
      const watch = () => {
        clearTimeout(watchdog);
        watchdog = self.setTimeout(() => request.abort(), STALLED_MS);
      };
      const callBack = () => request.abort();
      const end = (answer: PutAnswer) => {
        clearTimeout(watchdog);
        signal.removeEventListener("abort", callBack);
        resolve(answer);
      };
      request.upload.onprogress = ({ loaded }) => {
        watch();
        moved(loaded - sent);
        sent = loaded;
      };
      request.onload = () => end(understood(request));
      request.onerror = () => end({ meaning: "try_again", etag: "", reason: "" });
      request.onabort = () => end({ meaning: signal.aborted ? "called_back" : "try_again", etag: "", reason: "" });
      request.open("PUT", part.url);
      for (const [name, value] of Object.entries(part.headers)) {
        if (!BROWSERS_OWN.has(name.toLowerCase())) request.setRequestHeader(name, value);
      }
      if (signal.aborted) {
        end({ meaning: "called_back", etag: "", reason: "" });
        return;
      }
      signal.addEventListener("abort", callBack);
      watch();
      request.send(body);
    }),
};

function understood(request: XMLHttpRequest): PutAnswer {
  const { status } = request;
  // 412: written already, by an earlier try whose answer was lost; the address was signed for these bytes only.
  if (status < 300 || status === 412) {
    return { meaning: "taken", etag: etagOf(request.getResponseHeader("ETag")), reason: "" };
  }
  const code = /<Code>([A-Za-z]{1,64})<\/Code>/.exec(request.responseText)?.[1] ?? "";
  return { meaning: meaningOf(status, code), etag: "", reason: `${String(status)} ${code}`.trim() };
}

export function etagOf(header: string | null): string {
  return (header ?? "").replaceAll('"', "");
}
