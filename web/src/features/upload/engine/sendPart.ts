// Sending one part until the store has taken it, or has said often enough that it will not.

import { ApiProblem, type Asking, type Surroundings } from "./api";
import type { Hashing } from "./checksums";
import type { Journal } from "./journal";
import type { SignedPart } from "./types";
import { checkUnchanged } from "./reading";
import type { Part } from "./sending";
import { toSign } from "./sending";
import type { PutAnswer, Store } from "./store";
import type { Watcher } from "./watcher";

const REFUSALS = 4;

/** What an upload works with. */
export interface Parts {
  readonly asking: Asking;
  readonly store: Store;
  readonly journal: Journal;
  readonly hashing: Hashing;
  readonly watcher: Watcher;
  readonly around: Surroundings;
  readonly stop: AbortController;
}

/** The store would not take a part, for its own reason. */
export class StoreRefused extends Error {
  override readonly name = "StoreRefused";
}

/**
 * Send a part; resolves when the store has it and the journal says so, or its upload has ended meanwhile.
 *
 * @throws FileFailure, ApiProblem (of this upload, or of all), StoreRefused, Stopped
 */
export async function sendPart(part: Part, first: SignedPart, parts: Parts): Promise<void> {
  const { asking, around } = parts;
  const signAgain = async () => (await asking.sign([toSign(part)]))[0] as SignedPart;
  const tries = around.backoff.begin();
  let signed = first;
  let refusals = 0;
  while (!part.sending.ended) {
    await around.gate.passed();
    if (Date.parse(signed.expires_at) <= around.clock.now()) signed = await signAgain(); // spares sending it in vain
    const answer = await put(part, signed, parts);
    if (answer.meaning === "taken") {
      around.troubles.over("store");
      if (part.sizeBytes < part.sending.upload.size_bytes) {
        const { sending, number, checksum } = part;
        await parts.journal.record({ uploadId: sending.upload.id, number, checksum, etag: answer.etag });
      }
      return;
    }
    if (answer.meaning === "gone") throw goneAt(part);
    if (answer.meaning !== "called_back") await checkUnchanged(part.sending.planned);
    if (answer.meaning === "try_again") {
      around.troubles.note("store", around.clock.now());
      await tries.pause();
    } else if (answer.meaning !== "called_back" && ++refusals >= REFUSALS) {
      throw new StoreRefused(answer.reason);
    }
    signed = await signAgain();
  }
}

async function put(part: Part, signed: SignedPart, { store, around, watcher }: Parts): Promise<PutAnswer> {
  const { planned, path } = part.sending;
  const body = planned.file.slice(part.offset, part.offset + part.sizeBytes);
  let sent = 0;
  const answer = await store.put(signed, body, around.gate.called, (sizeBytes) => {
    sent += sizeBytes;
    watcher.moved(path, sizeBytes);
  });
  // A store says no more than that it took it all; a small part may have passed unheard.
  watcher.moved(path, answer.meaning === "taken" ? part.sizeBytes - sent : -sent);
  return answer;
}

function goneAt(part: Part): ApiProblem {
  const detail = `the store no longer knows the upload of ${part.sending.path}`;
  const code = "upload_gone";
  return new ApiProblem({ code, detail, status: 410, title: "upload gone", type: "urn:kleinkram:error:upload_gone" });
}
