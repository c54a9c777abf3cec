// The title of the page, in the window title and in announcements to screen readers.
import { ref } from "vue";
import { texts } from "@/texts/common";

/** The announcement to screen readers. */
export const announced = ref("");

let isArriving = false;

/** Notes that another page is about to be shown, whose heading is to have the focus. */
export function arrive(): void {
  isArriving = true;
}

/** Names the window after the page. */
export function nameWindow(title: string): void {
  document.title = title === "" ? texts.product : `${title} · ${texts.product}`;
}

/** Gives the focus to a page's heading, once for each page that one comes to. */
export function focusHeading(heading: HTMLElement | null, title: string): void {
  if (!isArriving || heading === null || title === "") return;
  isArriving = false;
  announced.value = title;
  heading.focus({ preventScroll: true });
}
