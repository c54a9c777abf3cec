"""What the C library does with memory that chunks no longer need. Reads nothing, holds nothing."""

from __future__ import annotations

_LARGE = 24 * 2**20


def keep_freed_memory() -> None:
    """Have up to 48 MB of freed memory kept for what is allocated next, in this process, rather than given back.

    Pages that come fresh from the system for each chunk cost as much as decompressing into them. glibc learns from an
    allocation by itself, made and freed without a byte of it being touched; other libraries learn nothing, and no harm.

    Source: mallopt(3), M_MMAP_THRESHOLD, "dynamic mmap threshold".
    """
    bytearray(_LARGE)
