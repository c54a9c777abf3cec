"""CRC-64/NVME: the standard's check value, and that checksums of parts combine into that of the whole."""

import os

import pytest

from kleinkram.contract.uploads import combine_crc64nvme, crc64nvme


def test_checksums_match_the_standard() -> None:
    assert crc64nvme(b"123456789") == 0xAE8B14860A799888


@pytest.mark.parametrize(("size_bytes", "split"), [(0, 0), (9, 0), (9, 9), (100_003, 17), (100_003, 65_536)])
def test_checksums_continue_and_combine(size_bytes: int, split: int) -> None:
    data = os.urandom(size_bytes)
    first, second = crc64nvme(data[:split]), crc64nvme(memoryview(data)[split:])
    assert crc64nvme(data[split:], first) == crc64nvme(data)
    assert combine_crc64nvme(first, second, size_bytes - split) == crc64nvme(data)
