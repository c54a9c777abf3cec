"""Which contents a repository holds, two million of them in 80 MB: names and sizes side by side, sorted."""

from array import array
from bisect import bisect_left
from collections.abc import Iterator

_NAME_BYTES = 32


class Names:
    """Names of 32 bytes, with the size of each, and a mark. Made in order of the names."""

    def __init__(self) -> None:
        self._names = bytearray()
        self._sizes = array("q")
        self._marks = bytearray()

    def append(self, name: bytes, size_bytes: int) -> None:
        """Add a name that comes after all there are."""
        self._names += name
        self._sizes.append(size_bytes)
        self._marks.append(0)

    def __len__(self) -> int:
        return len(self._sizes)

    def __getitem__(self, place: int) -> bytes:
        return bytes(self._names[place * _NAME_BYTES : (place + 1) * _NAME_BYTES])

    def place(self, name: bytes) -> int | None:
        """Return where a name stands, None where it does not."""
        place = bisect_left(self, name)
        return place if place < len(self) and self[place] == name else None

    def size_bytes(self, name: bytes) -> int | None:
        """Return the size of what has this name, None where nothing has."""
        place = self.place(name)
        return None if place is None else self._sizes[place]

    def mark(self, place: int) -> None:
        """Note that what stands there is wanted."""
        self._marks[place] = 1

    def marked(self, place: int) -> bool:
        """Say whether it was marked."""
        return bool(self._marks[place])

    def unmarked(self) -> Iterator[tuple[bytes, int]]:
        """Yield name and size of all that has no mark."""
        return ((self[place], self._sizes[place]) for place in range(len(self)) if not self._marks[place])

    def total_bytes(self) -> int:
        """Return the sum of all sizes."""
        return sum(self._sizes)
