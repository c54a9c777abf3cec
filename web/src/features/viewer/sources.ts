// The recordings that the viewer reads: one worker for each file, started when a panel needs it.
import type { Which, MessageRequest, MessagesRequest, ProductName, ReadMessage } from "@/recordings/products/products";
import type { CurveTime, DrawnCurves, OfferedFields, Opened, ReadableFormat } from "@/recordings/protocol";
import type { MessageAnswer, MessagesAnswer, RecordingReader, RequestOptions } from "@/recordings/reader";
import type { Series } from "./layout";
import { ReadFailure } from "@/recordings/failures";
import type { Span } from "@/recordings/formats/recording";

export interface SourceFile {
  readonly id: string;
  readonly path: string;
  readonly format: ReadableFormat;
  readonly size_bytes: number;
  /** From the first to the last message, or somewhat more. */
  readonly span: Span;
}

export interface SourceRecording {
  /** Its name in addresses: the beginning of its id. */
  readonly key: string;
  readonly name: string;
  /** In order of time. */
  readonly files: readonly SourceFile[];
}

/** What is read of a topic, without its name and the file. */
export type MessageAt<P extends ProductName> = Omit<MessageRequest<P>, "topic">;
export type MessagesIn<P extends ProductName> = Omit<MessagesRequest<P>, "topic">;

/** The reader's methods that are used. */
export type FileReader = Pick<RecordingReader, "open" | "message" | "messages" | "request" | "close">;

interface Open {
  readonly reader: FileReader;
  requests: number;
}

/** Workers at once. The one that was not used for the longest time ends first. */
export const MAX_READERS = 8;

export class Sources {
  private readonly open = new Map<string, Open>();
  /** By file and topic: the last message, without its product; null where there is none. */
  private readonly lasts = new Map<string, ReadMessage | null>();
  private isClosed = false;

  constructor(
    readonly recordings: readonly SourceRecording[],
    private readonly openReader: (file: SourceFile) => FileReader,
  ) {}

  /** The files of a recording. @throws ReadFailure topic_unknown, where the recording does not exist. */
  filesOf({ recording }: Pick<Series, "recording">): readonly SourceFile[] {
    const known = this.recordings.find(({ key }) => key === recording);
    if (known === undefined) throw new ReadFailure("topic_unknown");
    return known.files;
  }

  /** Find a message among the files of a recording. */
  async message<P extends ProductName>(series: Series, request: MessageAt<P>, options: RequestOptions): Promise<MessageAnswer<P>> {
    let best: MessageAnswer<P> = { message: null, searchedToNs: null, damaged: [] };
    for (const file of candidates(this.filesOf(series), request.which, request.atNs)) {
      if (best.message !== null && !mayHaveCloser(file, request.which, best.message.logTimeNs)) continue;
      const answer = await this.messageIn(file, series, request, options);
      if (answer === null) continue;
      if (answer.message !== null && (best.message === null || isCloser(request.which, answer.message.logTimeNs, best.message.logTimeNs))) best = answer;
      else if (best.message === null) best = { ...answer, message: null };
      if (answer.searchedToNs !== null) break; // what is further away is not searched
    }
    return best;
  }

  /** Find a message in one file. For times behind the file, its answer is remembered: each step of the play head asks again. */
  private async messageIn<P extends ProductName>(file: SourceFile, { topic }: Series, request: MessageAt<P>, options: RequestOptions): Promise<MessageAnswer<P> | null> {
    const key = `${file.id} ${topic}`;
    const isPast = request.which === "valid" && request.atNs >= file.span.toNs;
    const last = isPast ? this.lasts.get(key) : undefined;
    if (last === null) return null;
    if (last !== undefined && last.logTimeNs === request.shownNs) return { message: { ...last, product: null }, searchedToNs: null, damaged: [] };
    const answer = await this.use(file, (reader) => topicOrNone(reader.message({ ...request, topic }, options)));
    const isCertain = answer === null || (answer.searchedToNs === null && answer.damaged.length === 0);
    if (isPast && isCertain) this.lasts.set(key, answer === null || answer.message === null ? null : { ...answer.message, product: null });
    return answer;
  }

  messages<P extends ProductName>(file: SourceFile, series: Series, request: MessagesIn<P>, options: RequestOptions): Promise<MessagesAnswer<P> | null> {
    return this.use(file, (reader) => topicOrNone(reader.messages({ ...request, topic: series.topic }, options)));
  }

  /** The numeric fields of a topic, by the first file that has a message of it. */
  async fields(series: Series, options: RequestOptions): Promise<OfferedFields> {
    for (const file of this.filesOf(series)) {
      const offered = await this.use(file, (reader) => topicOrNone(reader.request("fields", { topic: series.topic }, options)));
      if (offered !== null) return offered;
    }
    throw new ReadFailure("topic_silent");
  }

  /** The curves of a topic in one file; null where the file has none of its messages. */
  curves(file: SourceFile, series: Series, span: Span & { maxBytes: number; time: CurveTime }, options: RequestOptions): Promise<{ opened: Opened; curves: DrawnCurves } | null> {
    return this.use(file, async (reader) => {
      const request = { topic: series.topic, fields: [...series.fields], ...span };
      const curves = await topicOrNone(reader.request("curves", request, options));
      return curves === null ? null : { opened: await reader.open(), curves };
    });
  }

  close(): void {
    this.isClosed = true;
    for (const { reader } of this.open.values()) reader.close();
    this.open.clear();
  }

  private async use<Result>(file: SourceFile, act: (reader: FileReader) => Promise<Result>): Promise<Result> {
    if (this.isClosed) throw new ReadFailure("cancelled"); // what waited for another request still comes here
    const open = this.open.get(file.id) ?? { reader: this.openReader(file), requests: 0 };
    this.open.delete(file.id);
    this.open.set(file.id, open); // as the youngest
    open.requests += 1;
    this.closeUnused();
    try {
      return await act(open.reader);
    } finally {
      open.requests -= 1;
    }
  }

  private closeUnused(): void {
    for (const [id, { reader, requests }] of this.open) {
      if (this.open.size <= MAX_READERS) return;
      if (requests > 0) continue;
      reader.close();
      this.open.delete(id);
    }
  }
}

/** Returns null instead of the failure that a file has no message of the topic, as others of the recording do. */
async function topicOrNone<Result>(answer: Promise<Result>): Promise<Result | null> {
  try {
    return await answer;
  } catch (thrown) {
    if (thrown instanceof ReadFailure && (thrown.code === "topic_unknown" || thrown.code === "topic_silent")) return null;
    throw thrown;
  }
}

/** The files that can have the message, the most likely first. */
function candidates(files: readonly SourceFile[], which: Which, atNs: bigint): readonly SourceFile[] {
  if (which === "next") return files.filter(({ span }) => span.toNs > atNs);
  return files.filter(({ span }) => span.fromNs <= atNs).toReversed();
}

function isCloser(which: Which, timeNs: bigint, bestNs: bigint): boolean {
  return which === "next" ? timeNs < bestNs : timeNs > bestNs;
}

function mayHaveCloser({ span }: SourceFile, which: Which, bestNs: bigint): boolean {
  return which === "next" ? span.fromNs < bestNs : span.toNs > bestNs;
}

/** Returns the times at which a recording ran, merged, in order. */
export function recordedSpans(recordings: readonly SourceRecording[]): Span[] {
  const spans = recordings.flatMap(({ files }) => files.map(({ span }) => span)).toSorted((a, b) => (a.fromNs < b.fromNs ? -1 : 1));
  const merged: Span[] = [];
  for (const span of spans) {
    const last = merged.at(-1);
    if (last === undefined || span.fromNs > last.toNs) merged.push(span);
    else if (span.toNs > last.toNs) merged[merged.length - 1] = { fromNs: last.fromNs, toNs: span.toNs };
  }
  return merged;
}
