"""CRC-64/NVME: the check value of the standard, and checksums that are continued."""

import os

import pytest

from kleinkram.contract.uploads import crc64nvme


def test_checksums_match_the_standard() -> None:
    assert crc64nvme(b"123456789") == 0xAE8B14860A799888


@pytest.mark.parametrize(("size_bytes", "split"), [(0, 0), (9, 0), (9, 9), (100_003, 17), (100_003, 65_536)])
def test_a_checksum_can_be_continued(size_bytes: int, split: int) -> None:
    data = os.urandom(size_bytes)
    assert crc64nvme(memoryview(data)[split:], crc64nvme(data[:split])) == crc64nvme(data)
