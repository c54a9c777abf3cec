"""The outline of zstd data: where its frames and blocks end. Decompresses nothing, keeps a few bytes.

Source: RFC 8878, section 3.1.1 (blocks) and 3.1.2 (skippable frames).
"""

from __future__ import annotations

from collections.abc import Callable


class ZstdFrames:
    """Follows the frames of packed bytes, to know whether they end where a frame ends: zstandard does not tell."""

    def __init__(self) -> None:
        self._head = b""
        self._wanted = 4
        self._skip = 0
        self._step: Callable[[bytes], None] = self._on_magic
        self._checksum_bytes = 0

    @property
    def at_end_of_frame(self) -> bool:
        """Say whether the bytes so far end with a frame."""
        return not self._head and not self._skip and self._step == self._on_magic

    def feed(self, data: bytes) -> None:
        """Follow the next packed bytes."""
        at = 0
        while at < len(data):
            if self._skip:
                passed = min(self._skip, len(data) - at)
                self._skip -= passed
                at += passed
                continue
            piece = data[at : at + self._wanted - len(self._head)]
            self._head += piece
            at += len(piece)
            if len(self._head) == self._wanted:
                head, self._head = self._head, b""
                self._step(head)

    def _next(self, step: Callable[[bytes], None], wanted: int, *, skip: int = 0) -> None:
        self._step, self._wanted, self._skip = step, wanted, skip

    def _on_magic(self, head: bytes) -> None:
        if head[1:] == b"\x2a\x4d\x18" and head[0] >> 4 == 5:
            self._next(self._on_skippable, 4)
        else:
            self._next(self._on_descriptor, 1)

    def _on_skippable(self, head: bytes) -> None:
        self._next(self._on_magic, 4, skip=int.from_bytes(head, "little"))

    def _on_descriptor(self, head: bytes) -> None:
        size_flag, single_segment = head[0] >> 6, head[0] >> 5 & 1
        self._checksum_bytes = 4 if head[0] & 4 else 0
        size_bytes = (single_segment, 2, 4, 8)[size_flag]
        self._next(self._on_block, 3, skip=(1 - single_segment) + (0, 1, 2, 4)[head[0] & 3] + size_bytes)

    def _on_block(self, head: bytes) -> None:
        block = int.from_bytes(head, "little")
        body = 1 if block >> 1 & 3 == 1 else block >> 3
        if block & 1:
            self._next(self._on_magic, 4, skip=body + self._checksum_bytes)
        else:
            self._next(self._on_block, 3, skip=body)
