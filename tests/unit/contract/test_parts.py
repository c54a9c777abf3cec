import pytest
from hypothesis import given
from hypothesis import strategies as st

from kleinkram.contract.uploads import MAX_FILE_BYTES, MAX_PARTS, MIN_PART_BYTES, part_size_bytes

_GIB = 1024**3


@pytest.mark.parametrize(
    ("size_bytes", "part_bytes"),
    [(0, 5 << 20), (1, 5 << 20), (40 * _GIB, 5 << 20), (40 * _GIB + 1, 10 << 20), (MAX_FILE_BYTES, 640 << 20)],
)
def test_part_size_follows_from_file_size(size_bytes: int, part_bytes: int) -> None:
    assert part_size_bytes(size_bytes) == part_bytes


@given(st.integers(min_value=0, max_value=MAX_FILE_BYTES))
def test_every_file_fits_into_the_parts_that_s3_allows(size_bytes: int) -> None:
    part_bytes = part_size_bytes(size_bytes)
    assert part_bytes % MIN_PART_BYTES == 0
    assert -(-size_bytes // part_bytes) <= MAX_PARTS
