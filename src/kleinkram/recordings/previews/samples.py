"""Even samples of what arrives one by one, without knowing how much will come."""

from __future__ import annotations

from typing import Generic, TypeVar

ItemT = TypeVar("ItemT")


class EvenSamples(Generic[ItemT]):
    """At most `max_items` items, evenly spread over all that were offered; at least half as many, if there are enough.

    `expected_count`: of items, as an index claims; a wrong number costs time, and nothing else.
    """

    def __init__(self, max_items: int, expected_count: int | None = None) -> None:
        self._max_items = max_items
        self._stride = max(1, -(-(expected_count or 0) // max(1, max_items * 3 // 4)))
        self._items: list[tuple[int, ItemT]] = []
        self.count = 0

    @property
    def items(self) -> list[ItemT]:
        """The sampled items, in the order in which they arrived."""
        return [item for _, item in self._items]

    def takes_next(self) -> bool:
        """Count an item, and return whether it is to be added."""
        self.count += 1
        return (self.count - 1) % self._stride == 0

    def add(self, item: ItemT) -> None:
        """Add the item for which `takes_next` was True."""
        self._items.append((self.count - 1, item))
        if len(self._items) > self._max_items:
            self._stride *= 2
            self._items = [(index, one) for index, one in self._items if index % self._stride == 0]
