"""Writers of recordings with each compression that their formats allow."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from enum import Enum
from typing import BinaryIO

import lz4.frame
import zstandard

from kleinkram.recordings.writing import bag_writer, mcap_writer


class Compression(str, Enum):
    """Compression of chunks, as MCAP spells it."""

    none = ""
    lz4 = "lz4"
    zstd = "zstd"


class BagCompression(str, Enum):
    """Compression of chunks, as bags spell it."""

    none = "none"
    bz2 = "bz2"
    lz4 = "lz4"


_MCAP: dict[Compression, Callable[[bytes], bytes]] = {
    Compression.none: bytes,
    Compression.lz4: lz4.frame.compress,
    Compression.zstd: zstandard.ZstdCompressor(level=1).compress,
}
_BAG: dict[BagCompression, Callable[[bytes], bytes]] = {
    BagCompression.none: bytes,
    BagCompression.bz2: bz2.compress,
    BagCompression.lz4: bag_writer.ros_lz4,
}


class McapWriter(mcap_writer.McapWriter):
    def __init__(
        self,
        file: BinaryIO,
        *,
        profile: str = "",
        library: str = "kleinkram",
        compression: Compression = Compression.zstd,
        chunk_bytes: int = 2**20,
    ) -> None:
        super().__init__(
            file,
            profile=profile,
            library=library,
            compression=compression.value,
            compress=_MCAP[compression],
            chunk_bytes=chunk_bytes,
        )


class BagWriter(bag_writer.BagWriter):
    def __init__(
        self, file: BinaryIO, *, compression: BagCompression = BagCompression.lz4, chunk_bytes: int = 768 * 1024
    ) -> None:
        super().__init__(file, compression=compression.value, compress=_BAG[compression], chunk_bytes=chunk_bytes)
