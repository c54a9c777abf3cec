"""Writing that is killed or runs out of space leaves nothing under the final name, and takes bounded memory."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from kleinkram.recordings import CannotWrite, Recording
from kleinkram.recordings.sample import generate_mcap
from kleinkram.recordings.writing.new_file import new_file
from tests.recording_files.whole_mcap import read_whole_mcap

MAX_MB = 200
_WRITE = r"""
import re, resource, sys
from pathlib import Path
from kleinkram.recordings import McapOptions, Recording, Ros1Messages

source, target, kind, limit = sys.argv[1:]
if int(limit):
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(limit), int(limit)))

def show(share):
    if share > 0.3 and kind.endswith("killed"):
        print("far enough", flush=True)
        sys.stdin.read()

with Recording.open(source) as recording:
    if kind == "parquet":
        recording.to_parquet(target)
    elif kind.startswith("to_bag"):
        recording.to_bag(target, on_progress=show)
    elif kind == "reencode":
        recording.to_mcap(target, options=McapOptions(ros1=Ros1Messages.reencode))
    else:
        recording.to_mcap(target, on_progress=show)
print(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1])
"""


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", _WRITE, *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("kind", ["to_mcap killed", "to_bag killed"])
def test_a_killed_writer_leaves_no_final_name_and_the_next_one_succeeds(tmp_path: Path, kind: str) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=8_000_000, duration_s=20)
    target = tmp_path / "made.mcap"
    process = start(str(tmp_path / "drive.mcap"), str(target), kind, "0")
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "far enough\n"
        with Recording.open(tmp_path / "drive.mcap") as recording, pytest.raises(CannotWrite, match="another process"):
            recording.to_mcap(target)
        process.send_signal(signal.SIGKILL)
    assert not target.exists()
    with Recording.open(tmp_path / "drive.mcap") as recording:
        assert recording.to_mcap(target).message_count == len(read_whole_mcap(target).messages)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.mcap", "made.mcap"]


def test_a_file_that_was_just_completed_is_not_written_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process opened the unfinished file, and gets its lock once the file has its final name."""
    real = fcntl.flock

    def complete_first(descriptor: int, operation: int) -> None:
        monkeypatch.undo()
        os.write(descriptor, b"complete")
        (tmp_path / ".a.part").rename(tmp_path / "a")
        real(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", complete_first)
    with pytest.raises(CannotWrite, match="another process"), new_file(tmp_path / "a"):
        pass
    assert (tmp_path / "a").read_bytes() == b"complete"


@pytest.mark.parametrize("kind", ["mcap", "to_bag", "parquet"])
def test_without_space_a_sentence_names_the_file(tmp_path: Path, kind: str) -> None:
    """A limit on the size of files stands for a full disk: both fail in the same call."""
    generate_mcap(tmp_path / "drive.mcap", size_bytes=8_000_000)
    target = tmp_path / "made"
    process = start(str(tmp_path / "drive.mcap"), str(target), kind, "1000000")
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    last = errors.strip().splitlines()[-1]
    assert last.startswith(f"kleinkram.recordings.errors.CannotWrite: {target}")
    assert last.endswith("cannot be written: File too large")
    left = [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "drive.mcap"]
    assert all(path.suffix == ".parquet" and path.stat().st_size <= 1_000_000 for path in left)


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last bytes and the name reach the disk before the call returns: an error there counts as well."""

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with (
        pytest.raises(CannotWrite, match="cannot be written: No space left on device"),
        new_file(tmp_path / "a") as file,
    ):
        file.write(b"some bytes")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["mcap", "bag", "reencode", "to_bag", "parquet"])
def test_memory_is_bounded(tmp_path: Path, large_mcap: Path, large_bag: Path, kind: str) -> None:
    source = large_bag if kind in ("bag", "reencode") else large_mcap
    process = start(str(source), str(tmp_path / "made"), kind, "0")
    output, errors = process.communicate(timeout=110)
    assert process.returncode == 0, errors
    assert int(output) / 1024 < MAX_MB
