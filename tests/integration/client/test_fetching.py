"""A file is downloaded in any order, verified as a whole, and only then named."""

import hashlib
import os
from pathlib import Path

import pytest

from kleinkram.client.errors import DestinationDiffers, DestinationRefused, VerifyFailed
from kleinkram.client.transfer.download_target import RANGE_BYTES, PartialFile
from kleinkram.client.transfer.plan import Crc64Hash
from tests.api_objects import file_read, link_to

CONTENT = os.urandom(3 * RANGE_BYTES + 77)
FILE = file_read("big.bin", content=CONTENT)
LINK = link_to(FILE, sha256=FILE.sha256)


def nothing() -> None:
    """Check for nothing."""


def bring(fetching: PartialFile, *numbers: int, content: bytes = CONTENT) -> None:
    """Fetch ranges in this order."""
    ranges = {number: (first, last) for number, first, last in fetching.missing()}
    for number in numbers:
        first, last = ranges[number]
        fetching.write(first, content[first : last + 1])
        fetching.arrived(number, last - first + 1)
        fetching.hash_ready(nothing)


def test_ranges_arrive_in_any_order(tmp_path: Path) -> None:
    target = tmp_path / "big.bin"
    fetching = PartialFile(LINK, target, overwrite=False)
    bring(fetching, 3, 1, 0)
    assert not target.exists()
    bring(fetching, 2)
    fetching.finish(nothing)
    fetching.close()
    assert target.read_bytes() == CONTENT
    assert [*tmp_path.iterdir()] == [target]


def test_the_next_run_resumes_the_download(tmp_path: Path) -> None:
    first = PartialFile(LINK, tmp_path / "big.bin", overwrite=False)
    bring(first, 0, 2)
    with pytest.raises(DestinationRefused, match="another klein process"):
        PartialFile(LINK, tmp_path / "big.bin", overwrite=False)
    first.close()
    with (tmp_path / "big.bin.klein-journal").open("a") as out:
        out.write('{"num')
    second = PartialFile(LINK, tmp_path / "big.bin", overwrite=False)
    assert [number for number, _, _ in second.missing()] == [1, 3]
    assert second.stored_bytes() == 2 * RANGE_BYTES
    bring(second, 1, 3)
    second.finish(nothing)
    second.close()
    assert (tmp_path / "big.bin").read_bytes() == CONTENT


def test_a_partial_download_of_another_file_is_not_resumed(tmp_path: Path) -> None:
    first = PartialFile(LINK, tmp_path / "big.bin", overwrite=False)
    bring(first, 0)
    first.close()
    other = LINK.model_copy(update={"sha256": hashlib.sha256(b"other").hexdigest()})
    second = PartialFile(other, tmp_path / "big.bin", overwrite=False)
    assert len([*second.missing()]) == 4
    second.close()


@pytest.mark.parametrize("kind", ["sha256", "crc64nvme"])
def test_a_download_with_other_bytes_is_removed(tmp_path: Path, kind: str) -> None:
    crc = Crc64Hash()
    crc.update(memoryview(CONTENT))
    link = LINK if kind == "sha256" else link_to(FILE, sha256=None, crc64nvme=crc.hexdigest())
    fetching = PartialFile(link, tmp_path / "big.bin", overwrite=False)
    bring(fetching, 0, 1, 2, 3, content=CONTENT[:-1] + bytes([CONTENT[-1] ^ 1]))
    with pytest.raises(VerifyFailed, match=kind):
        fetching.finish(nothing)
    fetching.close()
    assert [*tmp_path.iterdir()] == []
    good = PartialFile(link, tmp_path / "big.bin", overwrite=False)
    bring(good, 0, 1, 2, 3)
    good.finish(nothing)
    good.close()


def test_a_file_created_during_the_download_is_not_replaced(tmp_path: Path) -> None:
    target = tmp_path / "big.bin"
    fetching = PartialFile(LINK, target, overwrite=False)
    bring(fetching, 0, 1, 2, 3)
    target.write_bytes(b"mine")
    with pytest.raises(DestinationDiffers):
        fetching.finish(nothing)
    fetching.close()
    assert target.read_bytes() == b"mine"


def test_a_temporary_name_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "victim").write_bytes(b"mine")
    (tmp_path / "big.bin.klein-part").symlink_to(tmp_path / "victim")
    with pytest.raises(DestinationRefused):
        PartialFile(LINK, tmp_path / "big.bin", overwrite=True)
    assert (tmp_path / "victim").read_bytes() == b"mine"
