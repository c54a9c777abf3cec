// Which rows of a long table are drawn: those in sight. The table scrolls with the page, or within a height of its own.
import { defaultRangeExtractor, type Range, useVirtualizer, useWindowVirtualizer, type VirtualItem } from "@tanstack/vue-virtual";
import { computed, type ComputedRef, onMounted, onScopeDispose, ref, type Ref } from "vue";

const OVERSCAN = 6;

export interface VirtualRows {
  readonly items: ComputedRef<readonly VirtualItem[]>;
  readonly total: ComputedRef<number>;
  /** How far a row is from the table's top. */
  readonly top: (item: VirtualItem) => number;
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

  const observer = new ResizeObserver(measure);
  onMounted(() => {
    measure();
    observer.observe(document.body); // what stands above the table pushes it
    if (options.body.value !== null) observer.observe(options.body.value);
  });
  onScopeDispose(() => observer.disconnect());

  return {
    items: computed(() => virtualizer.value.getVirtualItems()),
    total: computed(() => virtualizer.value.getTotalSize()),
    top: (item) => item.start - margin.value,
    reveal: (index) => virtualizer.value.scrollToIndex(index, { align: "auto" }),
    width,
  };
}
