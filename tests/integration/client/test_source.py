"""A changed file is detected; checksums are those of S3."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from kleinkram.client.errors import FileChanged
from kleinkram.client.transfer.plan import (
    SLICE_BYTES,
    Crc64Hash,
    FileHashes,
    FileIdentity,
    LocalFile,
    OpenFile,
    identity_of,
    new_checksum,
)
from kleinkram.client.transfer.upload import batches
from kleinkram.contract.uploads import ChecksumKind


@pytest.fixture
def local(tmp_path: Path) -> LocalFile:
    path = tmp_path / "a.bin"
    path.write_bytes(os.urandom(2 * SLICE_BYTES + 5))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    return LocalFile(path, "a.bin", identity_of(path.stat()))


def test_slices_are_the_bytes(local: LocalFile) -> None:
    source = OpenFile(local)
    whole = FileHashes()
    for view in source.slices(0, local.size_bytes):
        whole.update(view)
    assert whole.sha256.hexdigest() == hashlib.sha256(local.source.read_bytes()).hexdigest()
    assert (
        b"".join(bytes(view) for view in source.slices(3, SLICE_BYTES)) == local.source.read_bytes()[3:][:SLICE_BYTES]
    )
    source.check_unchanged()
    source.close()


def _append(path: Path) -> None:
    with path.open("ab") as out:
        out.write(b"x")


def _overwrite(path: Path) -> None:
    with path.open("r+b") as out:
        out.write(b"x")


def _replace(path: Path) -> None:
    other = path.with_name("other")
    other.write_bytes(path.read_bytes())
    os.utime(other, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns))
    other.replace(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [(_append, "bytes"), (_overwrite, "written"), (_replace, "place"), (Path.unlink, "gone")],
)
def test_every_change_of_a_file_is_detected(local: LocalFile, change: Callable[[Path], None], reason: str) -> None:
    source = OpenFile(local)
    change(local.source)
    with pytest.raises(FileChanged, match=reason):
        source.check_unchanged()
    source.close()
    with pytest.raises(FileChanged, match=reason):
        OpenFile(local)


def test_a_file_cut_short_while_it_is_read_is_found(local: LocalFile) -> None:
    source = OpenFile(local)
    os.truncate(local.source, 10)
    with pytest.raises(FileChanged, match="shorter"):
        [bytes(view) for view in source.slices(0, local.size_bytes)]
    source.close()


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (ChecksumKind.crc64nvme, "ae8b14860a799888"),
        (ChecksumKind.sha256, hashlib.sha256(b"123456789").hexdigest()),
        (ChecksumKind.md5, "25f9e794323b453885f5181f1b624d0b"),
    ],
)
def test_checksums_have_their_check_values(kind: ChecksumKind, expected: str) -> None:
    checksum = new_checksum(kind)
    checksum.update(memoryview(b"1234"))
    checksum.update(memoryview(b"56789"))
    assert checksum.hexdigest() == expected


def test_an_empty_crc_has_sixteen_digits() -> None:
    assert Crc64Hash().hexdigest() == "0" * 16


def test_files_are_announced_in_batches() -> None:
    def of(size: int) -> LocalFile:
        return LocalFile(Path("x"), "x", FileIdentity(size, 0, 0, 0))

    mib = 1024 * 1024
    assert [len(batch) for batch in batches([of(1000)] * 150)] == [16, 100, 34]
    assert [len(batch) for batch in batches([of(8 * mib)] * 40)] == [16, 16, 8]
    assert [len(batch) for batch in batches([of(1000), of(10**12), of(1000)])] == [1, 1, 1]
    assert [*batches([])] == []
