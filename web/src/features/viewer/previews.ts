// The previews of the viewer's recordings, each opened when it is first needed.
import { api, call } from "@/api/client";
import { PreviewFile } from "@/recordings/preview_file";
import { ReadFailure } from "@/recordings/failures";
import { Ranges, type Address } from "@/recordings/ranges";

async function readPreview(fileId: string) {
  return call(api.GET("/api/v1/files/{file_id}/preview", { params: { path: { file_id: fileId } } }));
}

/** Opens the preview of a recording; null if the server has none. */
async function openPreview(fileId: string, signal: AbortSignal): Promise<PreviewFile | null> {
  const preview = await readPreview(fileId);
  if (preview.state !== "ready" || typeof preview.size_bytes !== "number" || signal.aborted) return null;
  let first: Address | null = addressOf(preview);
  const ranges = new Ranges({
    sizeBytes: preview.size_bytes,
    renew: async () => {
      const address = first ?? addressOf(await readPreview(fileId));
      first = null;
      if (address === null) throw new ReadFailure("link_refused");
      return address;
    },
  });
  ranges.signal = signal;
  return PreviewFile.open(ranges);
}

function addressOf({ url, expires_at: expiresAt }: { url?: string | null; expires_at?: string | null }): Address | null {
  return !url || !expiresAt ? null : { url, expiresAtMs: Date.parse(expiresAt) };
}

export class Previews {
  private readonly files = new Map<string, Promise<PreviewFile | null>>();
  private readonly ending = new AbortController();

  constructor(private readonly open: (fileId: string, signal: AbortSignal) => Promise<PreviewFile | null> = openPreview) {}

  /** Returns the preview of a file; null if it has none. What fails is tried again the next time. */
  of(fileId: string): Promise<PreviewFile | null> {
    const opened = this.files.get(fileId) ?? this.open(fileId, this.ending.signal);
    this.files.set(fileId, opened);
    opened.catch(() => this.files.delete(fileId));
    return opened;
  }

  close(): void {
    this.ending.abort();
  }
}
