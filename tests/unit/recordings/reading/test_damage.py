"""Reading damaged recordings: every message that a scan counts is read, and the reported loss is correct."""

from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kleinkram.recordings import NotARecording, Recording
from tests.integration.recordings.test_damage import MESSAGES, NAMES, PLACES, WHOLE, scanned
from tests.recording_files.memory_source import MemorySource

BAG = WHOLE["bz2.bag"].data
CHUNK_COUNT = (BAG.index(b"chunk_count=") + 12 - 13 + 0.5) / (len(BAG) - 14)
"""The place of a byte that says how many chunks a bag has."""


def read(data: bytes, name: str) -> tuple[int, int, dict[str, str]]:
    """Return how many messages are read, how many are left out as too late, and the problems by code."""
    with Recording.open(MemorySource(data, name)) as recording:
        stamps = [message.log_time_ns for message in recording.raw_messages()]
        problems = {problem.code: problem.message for problem in recording.problems}
    assert stamps == sorted(stamps)
    return len(stamps), int(problems.get("too-late", "0").split()[0]), problems


def assert_all_read(data: bytes, name: str) -> None:
    """By its index a reader may find a chunk whose own head is damaged, which a scan leaves out: it reads more then."""
    counted = scanned(data, name).message_count
    actual, late, problems = read(data, name)
    assert counted is not None
    assert counted <= actual + late <= MESSAGES
    is_rebuilt = problems.keys() & {"no-footer", "no-index", "index-damaged"} and not late
    if is_rebuilt:
        assert actual == counted


def damaged(name: str, how: str, place: float, length: int) -> bytes:
    data = WHOLE[name].data
    start = 13 + int(place * (len(data) - 14))
    end = min(len(data), start + length)
    if how == "zeros":
        return data[:start] + bytes(end - start) + data[end:]
    if how == "sector":
        return data[:start] + data[end:]
    if how == "cut":
        return data[:start]
    return data[:start] + bytes([data[start] ^ 1 << length % 8]) + data[start + 1 :]


@given(NAMES, st.sampled_from(("zeros", "sector", "cut", "bit")), PLACES, st.integers(1, 4096))
@example("none.mcap", "zeros", 0.7773971822959025, 1684)  # what is left of one chunk is searched among zeros
@example("none.bag", "bit", 0.5827126780061346, 1065)  # a message's time becomes earlier than its chunk's
@example("bz2.bag", "bit", 0.5477902743388547, 3386)  # a chunk that only the index can find
@example("bz2.bag", "zeros", 0.9625780948983345, 1)  # the index lists a chunk where none stands
@example("bz2.bag", "bit", CHUNK_COUNT, 8)  # the bag's header says one chunk less than the index lists
@settings(max_examples=250, deadline=None)
def test_as_many_messages_are_read_as_a_scan_counts(name: str, how: str, place: float, length: int) -> None:
    assert_all_read(damaged(name, how, place, length), name)


@pytest.mark.parametrize("rubbish", [bytes(3000), bytes(range(1, 251)) * 12], ids=["zeros", "rubbish"])
@pytest.mark.parametrize("name", sorted(WHOLE))
def test_rubbish_between_chunks_costs_no_message(name: str, rubbish: bytes) -> None:
    whole = WHOLE[name]
    middle = whole.chunks[len(whole.chunks) // 2][0]
    data = whole.data[:middle] + rubbish + whole.data[middle:]
    assert scanned(data, name).message_count == MESSAGES
    assert read(data, name)[0] == MESSAGES


def test_a_cut_chunk_is_not_reported_as_left_out() -> None:
    whole = WHOLE["none.mcap"]
    start, end, messages = whole.chunks[2]
    before = sum(count for _, _, count in whole.chunks[:2])
    with Recording.open(MemorySource(whole.data[: (start + end) // 2], "cut.mcap")) as recording:
        actual = len(list(recording.raw_messages()))
        stated = [problem.message for problem in recording.problems]
    assert before < actual < before + messages
    assert any("a chunk of" in message and "bytes follow" in message for message in stated)
    assert not any("left out" in message or "checksum" in message for message in stated)


def test_a_partly_read_chunk_is_not_reported_as_left_out() -> None:
    whole = WHOLE["none.mcap"]
    _, end, _ = whole.chunks[2]
    data = bytearray(whole.data)
    data[end - 40 : end - 10] = bytes(30)
    actual, _, problems = read(bytes(data), "holed.mcap")
    assert actual == scanned(bytes(data), "holed.mcap").message_count
    assert ("left out" in problems["damaged"]) == (actual == MESSAGES - whole.chunks[2][2])


def test_a_format_without_a_reader_is_refused_by_name() -> None:
    head = b"\x89MCAP0\r\n\x01" + bytes(8) + b"libmcap stereolabs" + bytes(64)
    with pytest.raises(NotARecording, match="SVO2 of a ZED camera, and reading that format is not supported"):
        Recording.open(MemorySource(head, "camera.svo2"))
