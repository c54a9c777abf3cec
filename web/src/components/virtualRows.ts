// Which rows of a long table are drawn: those in sight. The table scrolls with the page, or within a height of its own.
// When many come into sight at once, as beneath a scroll bar that is pulled, each frame draws some: none takes long.
// While it scrolls no element changes its place among its siblings, which would cost more than all else.
import { onMounted, onScopeDispose, readonly, ref, shallowRef, watch, type Ref } from "vue";
import { drawnAfter, inSight } from "./table";

const MOST_A_FRAME = 6;
const REST_MS = 150;
/** What the head of a table covers of the rows beneath it. */
const HEAD = 37;

export interface VirtualRows {
  /** The rows that are drawn: those in sight, and at times some that went, in whose place one is drawn soon. */
  readonly drawn: Readonly<Ref<readonly number[]>>;
  /** Whether it scrolls: what is drawn need not stand in order in the document then. */
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
}

/** Returns the rows in sight. */
export function useVirtualRows({ body, scroller, count, pinned, rowHeight, isOwnScroller, extra }: VirtualOptions): VirtualRows {
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
    // Rows below the open one stand lower than their number says, so some more are drawn above.
    const visible = inSight(top - extra(), height + extra(), rowHeight(), count(), pinned());
    drawn.value = drawnAfter(drawn.value, visible, pinned(), MOST_A_FRAME);
    const there = new Set(drawn.value);
    frame = visible.every((index) => there.has(index)) ? null : requestAnimationFrame(draw);
  }

  function follow(): void {
    frame ??= requestAnimationFrame(draw); // what scrolls is told before that, in the same frame: nothing comes later
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
    const by = from < top + HEAD ? from - top - HEAD : Math.max(0, to - top - height);
    if (by !== 0) moving()?.scrollBy({ top: by });
  }

  const observer = new ResizeObserver(measure);
  let heard: HTMLElement | Window | null = null;
  onMounted(() => {
    heard = isOwnScroller ? scroller.value : window;
    heard?.addEventListener("scroll", onScroll, { passive: true });
    measure();
    observer.observe(document.body); // what stands above the table pushes it
    if (body.value !== null) observer.observe(body.value);
  });
  onScopeDispose(() => {
    heard?.removeEventListener("scroll", onScroll);
    observer.disconnect();
    clearTimeout(resting);
    if (frame !== null) cancelAnimationFrame(frame);
  });
  watch([count, pinned, rowHeight, extra], follow);
  draw();

  return { drawn, isMoving: readonly(isMoving), reveal, rest, width: readonly(width) };
}
