// The title of the page, in the window title and in announcements to screen readers.
import { ref } from "vue";
import { texts } from "@/texts/common";

/** The announcement to screen readers. */
export const announced = ref("");

let isFocusPending = false;

/** Moves the focus to the heading of the next page. */
export function focusNextHeading(): void {
  isFocusPending = true;
}

/** Names the window after the page. */
export function nameWindow(title: string): void {
  document.title = title === "" ? texts.product : `${title} · ${texts.product}`;
}

/** Focuses and announces the heading of a page, once after each navigation. */
export function focusHeading(heading: HTMLElement | null, title: string): void {
  if (!isFocusPending || heading === null || title === "") return;
  isFocusPending = false;
  announced.value = title;
  heading.focus({ preventScroll: true });
}
