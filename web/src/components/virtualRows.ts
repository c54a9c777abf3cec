// The visible rows of a long table, which scrolls with the page or in a container.
// When many rows appear at once (dragging the scroll bar), each frame renders some of them.
// While it scrolls, no element is reordered among its siblings, which would be slow.
import { onScopeDispose, readonly, ref, shallowRef, watch, type Ref } from "vue";
import { drawnAfter, inSight } from "./table";

const MAX_A_FRAME = 6;
const REST_MS = 150;
/** The height of the sticky head of most tables, in pixels. */
const HEAD = 37;

export interface VirtualRows {
  /** The rendered rows: the visible ones, and temporarily some that left the view. */
  readonly drawn: Readonly<Ref<readonly number[]>>;
  /** Whether it scrolls: rows need not be in document order then. */
  readonly isMoving: Readonly<Ref<boolean>>;
  readonly reveal: (index: number) => void;
  readonly rest: () => void;
  readonly width: Readonly<Ref<number>>;
}

export interface VirtualOptions {
  readonly body: Ref<HTMLElement | null>;
  readonly scroller: Ref<HTMLElement | null>;
  readonly count: () => number;
  /** A row that stays drawn out of sight, since it has the focus. */
  readonly pinned: () => number;
  readonly rowHeight: () => number;
  readonly isOwnScroller: boolean;
  /** How much higher than the others the one open row is, in pixels. */
  readonly extra: () => number;
  /** The height of a sticky head that covers rows, in pixels. */
  readonly head?: () => number;
}

/** Returns the rows to render. */
export function useVirtualRows({ body, scroller, count, pinned, rowHeight, isOwnScroller, extra, head = () => HEAD }: VirtualOptions): VirtualRows {
  const width = ref(1024);
  const drawn = shallowRef<readonly number[]>([]);
  const isMoving = ref(false);
  let margin = 0;
  let frame: number | null = null;
  let resting: ReturnType<typeof setTimeout> | undefined;

  const moving = () => (isOwnScroller ? scroller.value : document.documentElement);
  const seen = () => ({ top: (moving()?.scrollTop ?? 0) - margin, height: moving()?.clientHeight ?? window.innerHeight });

  function draw(): void {
    const { top, height } = seen();
    // Rows below an expanded one are lower than their number implies, so more rows above are rendered.
    const visible = inSight(top - extra(), height + extra(), rowHeight(), count(), pinned());
    drawn.value = drawnAfter(drawn.value, visible, pinned(), MAX_A_FRAME);
    const rendered = new Set(drawn.value);
    frame = visible.every((index) => rendered.has(index)) ? null : requestAnimationFrame(draw);
  }

  function follow(): void {
    frame ??= requestAnimationFrame(draw); // scroll events of the same frame come before it
  }

  function rest(): void {
    clearTimeout(resting);
    isMoving.value = false;
  }

  function onScroll(): void {
    follow();
    isMoving.value = true;
    clearTimeout(resting);
    resting = setTimeout(rest, REST_MS);
  }

  function measure(): void {
    const [element, outer] = [body.value, moving()];
    if (element === null || outer === null) return;
    width.value = element.clientWidth;
    const edge = isOwnScroller ? outer.getBoundingClientRect().top : 0;
    margin = element.getBoundingClientRect().top - edge + outer.scrollTop;
    follow();
  }

  function reveal(index: number): void {
    const { top, height } = seen();
    const [from, to] = [index * rowHeight(), (index + 1) * rowHeight()];
    const by = from < top + head() ? from - top - head() : Math.max(0, to - top - height);
    if (by !== 0) moving()?.scrollBy({ top: by });
  }

  const observer = new ResizeObserver(measure);
  watch(body, (element, _previous, onCleanup) => {
    const source = isOwnScroller ? scroller.value : window;
    if (element === null || source === null) return;
    source.addEventListener("scroll", onScroll, { passive: true });
    window.addEventListener("resize", measure); // a higher window shows more rows, while the page keeps its size
    measure();
    observer.observe(document.body); // content above the table moves it
    observer.observe(element);
    onCleanup(() => {
      source.removeEventListener("scroll", onScroll);
      window.removeEventListener("resize", measure);
      observer.disconnect();
    });
  }, { flush: "post" });
  onScopeDispose(() => {
    clearTimeout(resting);
    if (frame !== null) cancelAnimationFrame(frame);
  });
  watch([count, pinned, rowHeight, extra], follow);
  draw();

  return { drawn, isMoving: readonly(isMoving), reveal, rest, width: readonly(width) };
}
