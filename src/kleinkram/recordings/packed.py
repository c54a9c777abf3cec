"""A table of whole numbers, 8 bytes a cell: what is kept of millions of chunks."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from operator import le
from typing import Generic, TypeVar

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_CHUNKS

Row = TypeVar("Row", bound=tuple[int, ...])


class PackedTable(Generic[Row]):
    """Rows of numbers from 0 to 2^64 - 1; `make` builds a row (a NamedTuple of `columns` numbers) again."""

    def __init__(self, make: Callable[..., Row], columns: int) -> None:
        self._make = make
        self._columns = columns
        self._cells = array("Q")

    def __len__(self) -> int:
        return len(self._cells) // self._columns

    def __getitem__(self, number: int) -> Row:
        at = number * self._columns
        return self._make(*self._cells[at : at + self._columns])

    def __iter__(self) -> Iterator[Row]:
        return (self[number] for number in range(len(self)))

    def append(self, row: Row) -> None:
        """Add a row.

        Raises:
            Malformed: a number that no file can hold, or more than `MAX_CHUNKS` rows.
        """
        if len(self) >= MAX_CHUNKS:
            raise Malformed("index", f"more than {MAX_CHUNKS} chunks", certain=False)
        size = len(self._cells)
        try:
            self._cells.extend(row)
        except OverflowError:
            del self._cells[size:]
            raise Malformed("index", "a chunk is said to lie beyond any file") from None

    def replace(self, number: int, row: Row) -> None:
        """Put another row in the place of one."""
        at = number * self._columns
        self._cells[at : at + self._columns] = array("Q", row)

    def pop(self) -> None:
        """Take the last row away, if there is one."""
        del self._cells[-self._columns :]

    def column(self, number: int) -> array[int]:
        """Return one column, in order."""
        return self._cells[number :: self._columns]

    def sort(self) -> None:
        """Bring the rows into the order of their first column."""
        keys = self.column(0)
        if all(map(le, keys, keys[1:])):
            return
        ordered = array("Q")
        for number in sorted(range(len(self)), key=keys.__getitem__):
            ordered.extend(self[number])
        self._cells = ordered


def smallest_to_come(values: array[int]) -> Iterator[int | None]:
    """Yield for each value the smallest of those behind it; None for the last."""
    smallest = array("Q")
    for value in reversed(values):
        smallest.append(min(value, smallest[-1]) if smallest else value)
    smallest.reverse()
    yield from smallest[1:]
    if smallest:
        yield None
