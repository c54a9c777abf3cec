// Which rows of a long table are drawn: those in sight. The table scrolls with the page, or within a height of its own.
// When many come into sight at once, as beneath a scroll bar that is pulled, each frame draws some: none takes long.
import { defaultRangeExtractor, type Range, useVirtualizer, useWindowVirtualizer } from "@tanstack/vue-virtual";
import { computed, type ComputedRef, onMounted, onScopeDispose, ref, type Ref, shallowRef, watch } from "vue";
import { drawnAfter } from "./table";

const OVERSCAN = 4;
const MOST_A_FRAME = 10;

export interface VirtualRows {
  /** The rows that are drawn: those in sight, and at times some that went, in whose place one is drawn soon. */
  readonly drawn: Readonly<Ref<readonly number[]>>;
  readonly total: ComputedRef<number>;
  readonly reveal: (index: number) => void;
  readonly width: Ref<number>;
}

export interface VirtualOptions {
  readonly body: Ref<HTMLElement | null>;
  readonly scroller: Ref<HTMLElement | null>;
  readonly count: () => number;
  /** A row that stays drawn out of sight, since it has the focus. */
  readonly kept: () => number;
  readonly rowHeight: number;
  readonly isOwnScroller: boolean;
}

/** Returns the rows in sight. */
export function useVirtualRows(options: VirtualOptions): VirtualRows {
  const margin = ref(0);
  const width = ref(1024);

  function rangeWithKept(range: Range): number[] {
    const inSight = defaultRangeExtractor(range);
    const kept = options.kept();
    if (kept >= range.count || inSight.includes(kept)) return inSight;
    return kept < range.startIndex ? [kept, ...inSight] : [...inSight, kept];
  }

  const common = () => ({
    count: options.count(),
    estimateSize: () => options.rowHeight,
    overscan: OVERSCAN,
    rangeExtractor: rangeWithKept,
  });
  const virtualizer = options.isOwnScroller
    ? useVirtualizer(computed(() => ({ ...common(), getScrollElement: () => options.scroller.value })))
    : useWindowVirtualizer(computed(() => ({ ...common(), scrollMargin: margin.value })));

  function measure(): void {
    const body = options.body.value;
    if (body === null) return;
    width.value = body.clientWidth;
    margin.value = options.isOwnScroller ? 0 : body.getBoundingClientRect().top + window.scrollY;
  }

  const wanted = computed(() => virtualizer.value.getVirtualItems().map(({ index }) => index));
  const drawn = shallowRef<readonly number[]>([]);
  let frame: number | null = null;

  function draw(): void {
    drawn.value = drawnAfter(drawn.value, wanted.value, options.kept(), MOST_A_FRAME);
    const isWhole = wanted.value.every((index) => drawn.value.includes(index));
    frame = isWhole ? null : requestAnimationFrame(draw);
  }

  watch(wanted, () => {
    if (drawn.value.length === 0) draw();
    else frame ??= requestAnimationFrame(draw); // what scrolls is told before that, in the same frame: nothing comes later
  }, { immediate: true });
  onScopeDispose(() => { if (frame !== null) cancelAnimationFrame(frame); });

  const observer = new ResizeObserver(measure);
  onMounted(() => {
    measure();
    observer.observe(document.body); // what stands above the table pushes it
    if (options.body.value !== null) observer.observe(options.body.value);
  });
  onScopeDispose(() => observer.disconnect());

  return {
    drawn,
    total: computed(() => virtualizer.value.getTotalSize()),
    reveal: (index) => virtualizer.value.scrollToIndex(index, { align: "auto" }),
    width,
  };
}
