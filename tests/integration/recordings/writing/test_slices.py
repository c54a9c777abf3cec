"""Slices of every whole real recording, compared with what independent readers see in the original."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.recordings import ChunkCompression, McapOptions, OutsideRecording, Recording, merge_to_mcap
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from tests.recording_files.agreement import ParallelSource
from tests.recording_files.corpus import MESSAGE_FORMATS, Entry, params_to_write
from tests.recording_files.independent import Stamped, independent_recording
from tests.recording_files.whole_mcap import WholeMcap, read_whole_mcap


def stamped(whole: WholeMcap) -> list[Stamped]:
    return [(topic, log_ns, data) for topic, log_ns, _publish_ns, _sequence, data in whole.messages]


def middle_third(messages: list[Stamped]) -> tuple[int, int]:
    first_ns, last_ns = messages[0][1], messages[-1][1]
    start_ns = first_ns + (last_ns - first_ns) // 3
    return start_ns, max(start_ns + 1, first_ns + 2 * (last_ns - first_ns) // 3)


@pytest.mark.parametrize("entry", params_to_write(*MESSAGE_FORMATS))
def test_slices_have_exactly_the_messages_of_independent_readers(
    entry: Entry, recordings_dir: Path, tmp_path: Path
) -> None:
    source = recordings_dir / entry.name
    expected = independent_recording(source).messages
    with Recording.open(source) as recording:
        if not expected:
            with pytest.raises(OutsideRecording):
                recording.to_mcap(tmp_path / "none.mcap", start=0, end=10**18)
            return
        names = sorted({topic for topic, _, _ in expected})
        half = names[: max(1, len(names) // 2)]
        start, end = middle_third(expected)
        lz4, no_latched = McapOptions(ChunkCompression.lz4), McapOptions(latched=False)
        whole = recording.to_mcap(tmp_path / "all.mcap", start=expected[0][1], end=expected[-1][1] + 1, options=lz4)
        recording.to_mcap(tmp_path / "half.mcap", half)
        third = recording.to_mcap(tmp_path / "third.mcap", start=start, end=end)
        recording.to_mcap(tmp_path / "both.mcap", half, start=start, end=end, options=no_latched)
    inside = [message for message in expected if start <= message[1] < end]
    assert whole.losses == ()
    assert stamped(read_whole_mcap(tmp_path / "all.mcap")) == expected
    assert stamped(read_whole_mcap(tmp_path / "half.mcap")) == [one for one in expected if one[0] in half]
    assert stamped(read_whole_mcap(tmp_path / "both.mcap")) == [one for one in inside if one[0] in half]
    made = stamped(read_whole_mcap(tmp_path / "third.mcap"))
    latched, rest = made[: third.latched_count], made[third.latched_count :]
    assert rest == inside
    earlier = {(topic, data) for topic, log_ns, data in expected if log_ns < start}
    assert {(topic, data) for topic, _, data in latched} <= earlier
    assert {log_ns for _, log_ns, _ in latched} <= {start}


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_static_transforms_of_a_sample_are_carried_along(tmp_path: Path, kind: str) -> None:
    make = {"mcap": generate_mcap, "bag": generate_bag, "db3": generate_db3}[kind]
    source = tmp_path / ("drive" if kind == "db3" else f"drive.{kind}")
    make(source, size_bytes=2_000_000, duration_s=20)
    with Recording.open(source) as recording:
        result = recording.to_mcap(tmp_path / "cut.mcap", ["/tf_static", "/imu/data"], start="+10s", end="+12s")
        assert recording.start_ns is not None
        start = recording.start_ns + 10 * 10**9
        (original,) = list(recording.raw_messages("/tf_static"))
    whole = read_whole_mcap(tmp_path / "cut.mcap")
    assert result.latched_count == 1
    assert stamped(whole)[0] == ("/tf_static", start, original.data)
    assert {topic for topic, _, _ in stamped(whole)[1:]} == {"/imu/data"}


def test_near_and_far_give_the_same_bytes(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=8_000_000, duration_s=20)
    with ParallelSource(tmp_path / "drive.mcap") as source:
        for name, opened in (("near", Recording.open(tmp_path / "drive.mcap")), ("far", Recording.open(source))):
            with opened as recording:
                recording.to_mcap(tmp_path / f"{name}.mcap", ["/imu/data", "/tf*"], start="+5s", end="+15s")
    assert (tmp_path / "near.mcap").read_bytes() == (tmp_path / "far.mcap").read_bytes()


def test_the_parts_of_a_cut_recording_merge_to_the_whole(tmp_path: Path) -> None:
    """Also with parts that overlap, whose common messages are there twice."""
    generate_mcap(tmp_path / "drive.mcap", size_bytes=4_000_000, duration_s=20)
    no_latched = McapOptions(latched=False)
    with Recording.open(tmp_path / "drive.mcap") as recording:
        recording.to_mcap(tmp_path / "a.mcap", end="+12s", options=no_latched)
        recording.to_mcap(tmp_path / "b.mcap", start="+8s", options=no_latched)
        recording.to_mcap(tmp_path / "c.mcap", start="+12s", options=no_latched)
        twice = len(list(recording.raw_messages(start="+8s", end="+12s")))
    original = stamped(read_whole_mcap(tmp_path / "drive.mcap"))
    for names, count in (("ac", len(original)), ("ab", len(original) + twice)):
        one, other = (Recording.open(tmp_path / f"{name}.mcap") for name in names)
        with one, other:
            result = merge_to_mcap([other, one], tmp_path / f"{names}.mcap")
        assert result.message_count == count
        merged = stamped(read_whole_mcap(tmp_path / f"{names}.mcap"))
        assert sorted(set(merged), key=lambda message: (message[1], message[0], message[2])) == sorted(
            set(original), key=lambda message: (message[1], message[0], message[2])
        )
