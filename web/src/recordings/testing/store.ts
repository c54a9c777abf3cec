/** A store for tests: answers ranges of bytes in memory as S3 does, and notes what it was asked. */

import { Ranges } from "../ranges";

export interface TestStore {
  ranges: Ranges;
  /** Bytes of each answer. */
  answers: number[];
  /** How often an address was asked for. */
  renewals: () => number;
  /** From now on, addresses given before are refused. */
  expire: () => void;
  change: (bytes: Uint8Array) => void;
}

export function storeOf(bytes: Uint8Array, { lifeMs = 3_600_000 } = {}): TestStore {
  let held = bytes;
  let etag = '"1"';
  let renewals = 0;
  let valid = 0;
  const answers: number[] = [];
  const answer: typeof fetch = (url, options) => {
    options?.signal?.throwIfAborted();
    if (Number(new URL(url as string).searchParams.get("n")) < valid) return Promise.resolve(new Response("", { status: 403 }));
    const [, from = "0", to = "0"] = /bytes=(\d+)-(\d+)/.exec(new Headers(options?.headers).get("range") ?? "") ?? [];
    const body = held.slice(Number(from), Number(to) + 1);
    answers.push(body.length);
    const headers = { "content-range": `bytes ${from}-${to}/${held.length}`, etag };
    return Promise.resolve(new Response(body, { status: 206, headers }));
  };
  const ranges = new Ranges({
    sizeBytes: bytes.length,
    renew: () => {
      renewals += 1;
      return Promise.resolve({ url: `http://store.test/file?n=${renewals}`, expiresAtMs: Date.now() + lifeMs });
    },
    fetch: answer,
  });
  return {
    ranges,
    answers,
    renewals: () => renewals,
    expire: () => (valid = renewals + 1),
    change: (changed) => {
      held = changed;
      etag = '"2"';
    },
  };
}
