// Reads the curves of one topic: those of the previews of a large recording, else the beginning up to a limit; then what
// is around the play head or in the part that is zoomed in, and the rest on demand.
import { computed, onScopeDispose, ref, shallowRef, watch, type ComputedRef, type Ref } from "vue";
import { AROUND_BYTES, bytesToReadAll, emptySegment, partAround, partsToDetail, partsWithin, PLOT_BYTES, segmentOf, unreadParts, withDetail, type Segment } from "./curves";
import type { Series } from "./layout";
import { chosenCurves, layoutCurves, type PlotCurve } from "./plot_curves";
import { roughSegments, type FileSeries } from "./rough_curves";
import type { SourceFile } from "./sources";
import { useReading } from "./useReading";
import { areFar, secondsOf, useViewer } from "./viewer";
import { ReadFailure } from "@/recordings/failures";
import type { Span } from "@/recordings/formats/recording";
import type { FieldNode } from "@/recordings/decoding/fields";
import type { CurveTime } from "@/recordings/protocol";

export interface SeriesCurves {
  readonly segments: Ref<readonly Segment[]>;
  /** The curves of the previews, in the parts that were not read. */
  readonly rough: ComputedRef<readonly Segment[]>;
  /** The fields that the topic offers; null until they are read. */
  readonly offered: Ref<readonly FieldNode[] | null>;
  /** What is drawn: the curves of the series, or the defaults of the message type. */
  readonly curves: ComputedRef<readonly PlotCurve[]>;
  /** What is read for them and for the differences of other series. */
  readonly columns: ComputedRef<readonly string[]>;
  readonly unread: ComputedRef<readonly Span[]>;
  readonly failure: Ref<ReadFailure | null>;
  readonly isReading: Ref<boolean>;
  /** What the curves need in all, in bytes, where some of it was not read; else 0. */
  readonly wholeBytes: ComputedRef<number>;
  readonly readAll: () => void;
  readonly again: () => void;
}

interface CurveOptions {
  /** Fields that the differences of other series subtract. */
  readonly operands?: () => readonly string[];
  readonly time?: () => CurveTime;
}

/** Curves come after the messages at the time of the play head. */
const AFTER_MESSAGES = 1_000;

/** How long the zoom rests before its part is read. */
const ZOOM_PAUSE_MS = 300;

/** Reads the curves of a series, and follows it, the play head, and the part of the time that is zoomed in. */
export function useCurves(series: () => Series, priority: () => number, zoomed: () => Span | null, { operands = () => [], time = () => "log" }: CurveOptions = {}): SeriesCurves {
  const { clock, sources, previews, topics } = useViewer();
  const segments = shallowRef<readonly Segment[]>([]);
  const previewed = shallowRef<readonly FileSeries[]>([]);
  const offered = shallowRef<readonly FieldNode[] | null>(null);
  const { failure, isReading, attempt, attemptUnasked, restart: restartReading, stop: stopReading } = useReading();
  /** Whether the offered fields are those of a preview, which leaves some out and has no vectors. */
  const isPreviewed = ref(false);
  let zoomToRead: Span | null = null;
  let zoomTimer: ReturnType<typeof setTimeout> | undefined;

  const topic = computed(() => topics.find(({ recording, name }) => recording === series().recording && name === series().topic));
  const files = computed(() => sources.recordings.find(({ key }) => key === series().recording)?.files ?? []);
  const curves = computed(() => {
    if (offered.value === null) return [];
    const { fields } = series();
    return isPreviewed.value && fields.length > 0 ? layoutCurves(fields) : chosenCurves(offered.value, fields, topic.value?.messageType ?? null);
  });
  const columns = computed(() => (offered.value === null ? [] : [...new Set([...curves.value.map(({ column }) => column), ...operands()])]));
  /** Of a small recording, everything is read anyway. */
  const isLarge = computed(() => files.value.reduce((sum, file) => sum + file.size_bytes, 0) > PLOT_BYTES);
  const rough = computed(() => roughSegments(previewed.value, segments.value, (timeNs) => secondsOf(clock, timeNs)));
  const unread = computed(() => files.value.flatMap((file) => unreadParts(file, segments.value)));
  const wholeBytes = computed(() => bytesToReadAll(files.value, segments.value));

  /** Reads a part; returns the bytes that the whole of it needs. */
  async function read(file: SourceFile, part: Span, maxBytes: number, signal: AbortSignal): Promise<number> {
    const before = segments.value;
    let shown = before;
    const show = (segment: Segment): void => {
      if (signal.aborted) throw new ReadFailure("cancelled");
      segments.value = shown = withDetail(before, segment, (timeNs) => secondsOf(clock, timeNs));
    };
    const undo = (): void => {
      if (segments.value === shown) segments.value = before;
    };
    signal.addEventListener("abort", undo);
    const startSeconds = secondsOf(clock, file.span.fromNs);
    try {
      const result = await sources.curves(file, { ...series(), fields: columns.value }, { ...part, maxBytes, time: time() }, {
        signal,
        priority: priority() + AFTER_MESSAGES,
        // What was read so far covers nothing yet: the rest stays marked as unread.
        onCurves: (drawn) => !signal.aborted && show(segmentOf(file.id, part, { ...drawn, untilNs: part.fromNs }, startSeconds)),
      });
      show(result === null ? emptySegment(file.id, part) : segmentOf(file.id, part, result.curves, secondsOf(clock, result.opened.span?.fromNs ?? file.span.fromNs)));
      return result?.curves.wholeBytes ?? 0;
    } finally {
      signal.removeEventListener("abort", undo);
    }
  }

  function readBeginning(): Promise<boolean> {
    return attemptUnasked(async (signal) => {
      if (isLarge.value && (await showPreviews(signal))) return readFields(signal);
      let bytesLeft = PLOT_BYTES;
      for (const file of files.value) {
        const [part] = unreadParts(file, segments.value);
        if (bytesLeft <= 0 || part === undefined) continue;
        bytesLeft -= await read(file, part, bytesLeft, signal);
      }
    });
  }

  /** Shows the curves of the previews; returns whether there are any. A preview that cannot be read is as good as none. */
  async function showPreviews(signal: AbortSignal): Promise<boolean> {
    previewed.value = [];
    for (const file of files.value) {
      const preview = await previews.of(file.id).catch(() => null);
      const bins = await preview?.series(series().topic, columns.value).catch(() => null);
      if (signal.aborted) throw new ReadFailure("cancelled");
      if (bins) previewed.value = [...previewed.value, { file, series: bins }];
    }
    return previewed.value.length > 0;
  }

  function readAll(): Promise<boolean> {
    return attempt(async (signal) => {
      for (const file of files.value) {
        for (const part of unreadParts(file, segments.value)) await read(file, part, Infinity, signal);
      }
    });
  }

  function readAround(): Promise<boolean> {
    return attemptUnasked(async (signal) => {
      for (const file of files.value) {
        const part = partAround(unreadParts(file, segments.value), clock.timeNs.value);
        if (part !== null) await read(file, part, AROUND_BYTES, signal);
      }
    });
  }

  function readWithin(span: Span): Promise<boolean> {
    return attemptUnasked(async (signal) => {
      let bytesLeft = PLOT_BYTES;
      for (const file of files.value) {
        for (const part of [...partsWithin(unreadParts(file, segments.value), span), ...partsToDetail(file.id, segments.value, span)]) {
          if (bytesLeft > 0) bytesLeft -= await read(file, part, bytesLeft, signal);
        }
      }
    });
  }

  /** Ends what is read, and learns the fields, from which the drawn ones follow: those of a preview are there first. */
  function restart(): void {
    stop();
    [offered.value, isPreviewed.value] = [null, false];
    void attempt(async (signal) => {
      const names = isLarge.value ? await previewedFields(signal) : [];
      if (names.length === 0) return readFields(signal);
      [offered.value, isPreviewed.value] = [names.map((path) => ({ label: path, path, children: [], hidden: 0 })), true];
    });
  }

  /** Reads the fields that the topic offers, unless they were read. */
  async function readFields(signal: AbortSignal): Promise<void> {
    if (offered.value !== null && !isPreviewed.value) return;
    const { fields: tree } = await sources.fields(series(), { signal, priority: priority() + AFTER_MESSAGES });
    if (!signal.aborted) [offered.value, isPreviewed.value] = [tree, false];
  }

  /** Returns the fields of the first preview that has the topic. */
  async function previewedFields(signal: AbortSignal): Promise<readonly string[]> {
    for (const file of files.value) {
      const names = await previews.of(file.id).then((preview) => preview?.fieldsOf(series().topic) ?? []).catch(() => []);
      if (signal.aborted) throw new ReadFailure("cancelled");
      if (names.length > 0) return names;
    }
    return [];
  }

  function stop(): void {
    stopReading();
    segments.value = [];
    previewed.value = [];
  }

  function draw(): void {
    if (offered.value === null) return;
    stop();
    zoomToRead = zoomed();
    if (columns.value.length > 0) void thenFollow(readBeginning());
  }

  /** Reads what is zoomed in, then around the play head where that was not read; goes on while either has changed since. */
  async function follow(): Promise<void> {
    if (isReading.value || failure.value !== null || columns.value.length === 0) return;
    const timeNs = clock.timeNs.value;
    const isUnread = unread.value.some((part) => timeNs >= part.fromNs && timeNs <= part.toNs);
    const span = zoomToRead;
    zoomToRead = null;
    const isRead = span !== null ? await readWithin(span) : isUnread && (await readAround());
    if (isRead) await follow();
  }

  async function thenFollow(reading: Promise<boolean>): Promise<void> {
    if (await reading) await follow();
  }

  watch(() => `${series().recording} ${series().topic}`, restart, { immediate: true });
  watch(() => JSON.stringify([offered.value === null, columns.value, time()]), draw);
  watch(clock.timeNs, (now, before) => void (areFar(now, before) ? thenFollow(restartReading()) : follow()));
  watch(zoomed, (span) => {
    clearTimeout(zoomTimer);
    zoomTimer = setTimeout(() => {
      zoomToRead = span;
      void follow();
    }, ZOOM_PAUSE_MS);
  });
  onScopeDispose(() => clearTimeout(zoomTimer));
  return { segments, rough, offered, curves, columns, unread, failure, isReading, wholeBytes, readAll: () => void thenFollow(readAll()), again: () => (offered.value === null ? restart() : draw()) };
}
