"""The child processes that read untrusted recordings: one person each, ended on any fault."""

import asyncio
import uuid
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from kleinkram.recordings import FailureKind, SummaryFailed
from kleinkram.recordings.isolation import FileRequest, request_bytes
from kleinkram.recordings.sample import generate_mcap
from kleinkram.server.blobs import readers as readers_module
from kleinkram.server.blobs.readers import ReaderProcesses

_ADA, _BOB = uuid.uuid4(), uuid.uuid4()


@pytest.fixture(name="recording", scope="module")
def _recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("reading") / "run.mcap"
    generate_mcap(path, size_bytes=300_000, seed=1)
    return path


def _with_readers(work: Callable[[ReaderProcesses], Awaitable[None]]) -> None:
    async def run() -> None:
        async with ReaderProcesses() as readers:
            await work(readers)

    asyncio.run(run())


def _pids(readers: ReaderProcesses) -> set[int]:
    return {reader.process.pid for reader in readers._idle}


def test_files_of_one_person_share_a_child_and_others_do_not(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        readers_module, "_IDLE_S", 60
    )  # on a busy machine the next child may take longer to start than that

    async def work(readers: ReaderProcesses) -> None:
        request = request_bytes(FileRequest(str(recording)))
        for owner in (_ADA, _ADA, _BOB):
            summary = await readers.summary(request, owner=owner, timeout_s=20)
            assert summary.message_count
        assert {(reader.owner, reader.files) for reader in readers._idle} == {(_ADA, 2), (_BOB, 1)}

    _with_readers(work)


def test_a_child_that_died_is_not_used_again(recording: Path) -> None:
    async def work(readers: ReaderProcesses) -> None:
        request = request_bytes(FileRequest(str(recording)))
        await readers.summary(request, owner=_ADA, timeout_s=20)
        readers._idle[0].process.kill()
        with pytest.raises(SummaryFailed) as failure:
            await readers.summary(request, owner=_ADA, timeout_s=20)
        assert failure.value.kind is FailureKind.crash
        assert (await readers.summary(request, owner=_ADA, timeout_s=20)).message_count

    _with_readers(work)


def test_a_child_that_takes_too_long_is_ended(recording: Path) -> None:
    async def work(readers: ReaderProcesses) -> None:
        request = request_bytes(FileRequest(str(recording)))
        with pytest.raises(SummaryFailed) as failure:
            await readers.summary(request, owner=_ADA, timeout_s=0.001)
        assert failure.value.kind is FailureKind.time
        assert _pids(readers) == set()

    _with_readers(work)


def test_closing_waits_for_a_reader_that_is_ending(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readers_module, "_IDLE_S", 0)

    async def run() -> None:
        async with ReaderProcesses() as readers:
            await readers.summary(request_bytes(FileRequest(str(recording))), owner=_ADA, timeout_s=20)
            (reader,) = readers._idle
            for _ in range(5):
                await asyncio.sleep(0)
            assert (readers._idle, reader.process.returncode) == ([], None)
        assert reader.process.returncode is not None

    asyncio.run(run())


def test_a_file_that_is_not_there_says_so(recording: Path, tmp_path: Path) -> None:
    async def work(readers: ReaderProcesses) -> None:
        missing = request_bytes(FileRequest(str(tmp_path / "none.bag")))
        with pytest.raises(SummaryFailed) as failure:
            await readers.summary(missing, owner=_ADA, timeout_s=20)
        assert failure.value.kind is FailureKind.source
        await readers.summary(request_bytes(FileRequest(str(recording))), owner=_ADA, timeout_s=20)

    _with_readers(work)
