/** Requests that wait for the worker: the most urgent one first, of equal ones the oldest. */

export interface Queued {
  id: number;
  /** Less is more urgent. */
  priority: number;
}

export class RequestQueue<Item extends Queued> {
  private readonly waiting: Item[] = [];

  add(item: Item): void {
    const place = this.waiting.findIndex(({ priority }) => priority > item.priority);
    this.waiting.splice(place < 0 ? this.waiting.length : place, 0, item);
  }

  /** Remove and return the most urgent request, if its priority is below `limit`. */
  take(limit = Infinity): Item | null {
    const [first] = this.waiting;
    if (first === undefined || first.priority >= limit) return null;
    this.waiting.shift();
    return first;
  }

  /** Remove a request; null where it does not wait. */
  remove(id: number): Item | null {
    const place = this.waiting.findIndex((item) => item.id === id);
    return place < 0 ? null : (this.waiting.splice(place, 1)[0] ?? null);
  }
}
