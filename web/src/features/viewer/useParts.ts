// Reads what a panel gathers from the messages of one topic: the beginning up to a limit, what is around the play head,
// and the rest on demand.
import { computed, shallowRef, watch, type ComputedRef, type Ref } from "vue";
import { partAround, unreadParts, type FilePart } from "./curves";
import type { Series } from "./layout";
import type { SourceFile } from "./sources";
import { useReading } from "./useReading";
import { areFar, useViewer } from "./viewer";
import type { ReadFailure } from "@/recordings/failures";
import type { Span } from "@/recordings/formats/recording";
import type { ProductName, ReadMessage } from "@/recordings/products/products";

/** What is made of messages, in order of time. Of bounded size, however many messages are added. */
export interface Gathering<P extends ProductName, Content> {
  readonly product: P;
  readonly empty: Content;
  readonly add: (content: Content, messages: readonly ReadMessage<P>[]) => Content;
}

export interface ReadPart<Content> extends FilePart {
  readonly content: Content;
}

export interface PartsRead<Content> {
  /** In order of time. */
  readonly parts: ComputedRef<readonly ReadPart<Content>[]>;
  readonly unread: ComputedRef<readonly Span[]>;
  readonly failure: Ref<ReadFailure | null>;
  readonly isReading: Ref<boolean>;
  readonly readAll: () => void;
  readonly again: () => void;
}

const PAGE_MESSAGES = 2_000;
const PAGE_BYTES = 4 * 2 ** 20;
/** Pages that are read unasked: of the beginning, and around the play head. */
const BEGINNING_PAGES = 4;
const AROUND_PAGES = 2;
/** What is gathered comes after the messages at the time of the play head. */
const AFTER_MESSAGES = 1_000;

/** Shows something else instead of the beginning of a series; returns whether it did. */
export type Instead = (files: readonly SourceFile[], signal: AbortSignal) => Promise<boolean>;

/** Gathers messages of a series, and follows it and the play head; without a series, it reads nothing. */
export function useParts<P extends ProductName, Content>(series: () => Series | undefined, gathering: Gathering<P, Content>, priority: () => number, instead?: Instead): PartsRead<Content> {
  const { clock, sources } = useViewer();
  const parts = shallowRef<readonly ReadPart<Content>[]>([]);
  const { failure, isReading, attempt, attemptUnasked, restart: restartReading, stop } = useReading();

  const files = computed(() => sources.recordings.find(({ key }) => key === series()?.recording)?.files ?? []);
  const unread = computed(() => files.value.flatMap((file) => unreadParts(file, parts.value)));

  /** Reads pages of an unread part; returns how many. */
  async function read(file: SourceFile, part: Span, maxPages: number, signal: AbortSignal): Promise<number> {
    const [source, others] = [series(), parts.value];
    let { empty: content } = gathering;
    let pages = 0;
    for (let { fromNs } = part; source !== undefined && fromNs <= part.toNs && pages < maxPages; pages += 1) {
      const request = { product: gathering.product, fromNs, toNs: part.toNs, maxMessages: PAGE_MESSAGES, maxBytes: PAGE_BYTES };
      const answer = await sources.messages(file, source, request, { signal, priority: priority() + AFTER_MESSAGES });
      if (signal.aborted) break;
      const untilNs = answer?.untilNs ?? part.toNs;
      content = gathering.add(content, answer?.messages ?? []);
      parts.value = [...others, { fileId: file.id, fromNs: part.fromNs, toNs: untilNs, content }];
      fromNs = untilNs + 1n;
    }
    return pages;
  }

  function readBeginning(): Promise<boolean> {
    return attemptUnasked(async (signal) => {
      if ((await instead?.(files.value, signal)) === true || signal.aborted) return;
      let pagesLeft = BEGINNING_PAGES;
      for (const file of files.value) {
        const [part] = unreadParts(file, parts.value);
        if (pagesLeft > 0 && part !== undefined) pagesLeft -= await read(file, part, pagesLeft, signal);
      }
    });
  }

  function readAll(): Promise<boolean> {
    return attempt(async (signal) => {
      for (const file of files.value) {
        for (const part of unreadParts(file, parts.value)) await read(file, part, Infinity, signal);
      }
    });
  }

  function readAround(): Promise<boolean> {
    return attemptUnasked(async (signal) => {
      for (const file of files.value) {
        const part = partAround(unreadParts(file, parts.value), clock.timeNs.value);
        if (part !== null) await read(file, part, AROUND_PAGES, signal);
      }
    });
  }

  function restart(): void {
    stop();
    parts.value = [];
    void thenFollow(readBeginning());
  }

  /** Reads around the play head where that was not read; goes on until it is, also where the play head has moved since. */
  async function follow(): Promise<void> {
    const timeNs = clock.timeNs.value;
    const isUnread = unread.value.some((part) => timeNs >= part.fromNs && timeNs <= part.toNs);
    if (isUnread && !isReading.value && failure.value === null && (await readAround())) await follow();
  }

  async function thenFollow(reading: Promise<boolean>): Promise<void> {
    if (await reading) await follow();
  }

  watch(() => `${series()?.recording} ${series()?.topic}`, restart, { immediate: true });
  watch(clock.timeNs, (now, before) => void (areFar(now, before) ? thenFollow(restartReading()) : follow()));
  const inOrder = computed(() => parts.value.toSorted((a, b) => (a.fromNs < b.fromNs ? -1 : 1)));
  return { parts: inOrder, unread, failure, isReading, readAll: () => void thenFollow(readAll()), again: restart };
}
