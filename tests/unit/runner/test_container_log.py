"""The copy of a container's log: exact after interruptions, truncated at its limit, and on a full disk."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.docker import container as docker_container
from kleinkram.runner.executors.docker.client import ContainerInfo, DockerClient, OutputPiece
from kleinkram.runner.executors.docker.container import LOG_LABEL, ContainerLog


class StoredOutput(DockerClient):
    """An engine that only stores the output of a container."""

    def __init__(self, pieces: list[bytes]) -> None:
        super().__init__(Path("/nowhere"))
        self.pieces = pieces

    def log(self, name: str, *, follow: bool, since_ns: int = 0) -> Iterator[list[OutputPiece]]:
        """Yield it; what is newer than a copy is the last piece."""
        for data in self.pieces[-1:] if since_ns else self.pieces:
            yield [OutputPiece(1, data)]


def copy(directory: Path, pieces: list[bytes], offset: int = 0) -> ContainerLog:
    """Copy the log of a container that has exited."""
    log = ContainerLog(StoredOutput(pieces), RunJob("a-job", directory, [], None, Resources(), Network.none))
    log.follow(ContainerInfo("one", "exited", 0, 0, was_out_of_memory=False, labels={LOG_LABEL: str(offset)}))
    log.finish()
    until = time.monotonic() + 60
    while not log.is_complete:
        assert time.monotonic() < until
        time.sleep(0.01)
    return log


@pytest.mark.parametrize("copied", [b"", b"one\nt", b"one\ntwo\n", b"one\ntwo\nthree"])
def test_an_interrupted_copy_continues(tmp_path: Path, copied: bytes) -> None:
    earlier = b"of an earlier start\n"
    (tmp_path / "log").write_bytes(earlier + copied)
    # As written before an append that was cut short.
    cursor = {"size": len(earlier), "copied": [0, 0], "next": 1}
    (tmp_path / "log.cursor").write_text(json.dumps(cursor))
    copy(tmp_path, [b"one\n", b"two\nthree", b"\n"], offset=20)
    assert (tmp_path / "log").read_bytes() == b"of an earlier start\none\ntwo\nthree\n"


def test_output_that_the_engine_dropped_is_marked(tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(b"one\ntwo\n")
    (tmp_path / "log.cursor").write_text(json.dumps({"size": 0, "copied": [0, 0], "next": 1}))
    copy(tmp_path, [b"eight\n", b"nine\n"])
    assert (tmp_path / "log").read_bytes().startswith(b"one\ntwo\n\n[kleinkram] lines may be missing here")
    assert (tmp_path / "log").read_bytes().endswith(b"\nnine\n")


def test_a_full_disk_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "log").symlink_to("/dev/full")
    assert not copy(tmp_path, [b"a word\n"]).has_space


def test_a_log_is_copied_up_to_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docker_container, "LOG_BYTES", 10)
    assert copy(tmp_path, [b"a word and more\n"]).has_space
    assert (tmp_path / "log").read_bytes().startswith(b"a word and\n[kleinkram] the log is full")
