"""Previews of the real recordings: extreme values are those of an independent reader; damage gives no error."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kleinkram.recordings import Recording
from kleinkram.recordings.decoding.transcode import legal_name
from kleinkram.recordings.errors import RecordingError
from kleinkram.recordings.previews import RecordingPreview, make_preview, preview_max_bytes, read_preview
from kleinkram.recordings.previews.columns import MAX_ELEMENTS, MAX_FIELDS
from tests.recording_files.corpus import Entry, entries, params
from tests.recording_files.independent import decoder_of, independent_recording

Extremes = dict[tuple[str, str], tuple[float, float]]
_TIME = {"sec", "nanosec"}
_LARGE_BYTES = 32 * 1024


def _preview(path: Path) -> RecordingPreview:
    with Recording.open(path) as recording:
        data = make_preview(recording)
        assert len(data) <= preview_max_bytes(recording.size_bytes)
    return read_preview(data)


def _numbers(value: object, path: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, bool | int | float):
        yield path, float(value)
    elif isinstance(value, dict) and set(value) != _TIME:
        for name, part in value.items():
            yield from _numbers(part, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and len(value) <= MAX_ELEMENTS:
        for number, part in enumerate(value):
            if isinstance(part, bool | int | float):
                yield f"{path}[{number}]", float(part)


def _independent_extremes(path: Path, topics: frozenset[str]) -> Extremes:
    recording = independent_recording(path)
    decoders = {topic: decoder_of(recording.types[topic]) for topic in topics}
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    for topic, _, data in recording.messages:
        if topic in decoders and len(data) <= _LARGE_BYTES:
            for name, number in _numbers(decoders[topic](data)):
                if not math.isnan(number):
                    values[topic, name].append(number)
    return {key: (min(numbers), max(numbers)) for key, numbers in values.items()}


def _extremes(preview: RecordingPreview) -> Extremes:
    return {
        (series.topic, ".".join(_plain(part) for part in field.name.split("."))): (
            float(np.nanmin(field.low)),
            float(np.nanmax(field.high)),
        )
        for series in preview.series
        for field in series.fields
    }


def _plain(part: str) -> str:
    name, bracket, rest = part.partition("[")
    return legal_name(name) + bracket + rest


@pytest.mark.parametrize("entry", params("MCAP", "ROS1 bag 2.0", "ROS2 sqlite3 db3"))
def test_extreme_values_are_those_of_an_independent_reader(entry: Entry, recordings_dir: Path) -> None:
    path = recordings_dir / entry.name
    preview = _preview(path)
    plottable = [series for series in preview.series if len(series.fields) < MAX_FIELDS and not series.is_sampled]
    with Recording.open(path) as recording:
        is_ros = {topic.name for topic in recording.topics if topic.message_encoding in ("ros1", "cdr")}
    topics = frozenset(series.topic for series in plottable if series.topic in is_ros)
    expected = _independent_extremes(path, topics)
    actual = {key: values for key, values in _extremes(preview).items() if key[0] in topics}
    compared = expected.keys() & actual.keys()
    assert compared or not topics
    assert {key: actual[key] for key in compared} == {key: expected[key] for key in compared}
    # Arrays of bytes are no fields of previews; sequence numbers are no fields of the other reader.
    missing = {key for key in expected.keys() - actual.keys() if not key[1].endswith("]")}
    assert not missing
    assert {key for key in actual.keys() - expected.keys() if not key[1].endswith(("seq", "]"))} == set()


@pytest.mark.parametrize("entry", params("MCAP", "ROS1 bag 2.0", "ROS2 sqlite3 db3"))
def test_bins_cover_all_messages_in_order(entry: Entry, recordings_dir: Path) -> None:
    preview = _preview(recordings_dir / entry.name)
    for series in preview.series:
        bins = len(series.first_ns)
        assert (bins - 1) * series.messages_per_bin < series.message_count <= bins * series.messages_per_bin
        assert (series.first_ns <= series.last_ns).all()
        assert (series.last_ns[:-1] <= series.first_ns[1:]).all()
        assert all(len(field.low) == len(field.high) == bins for field in series.fields)
        assert preview.start_ns is not None
        assert preview.start_ns <= series.first_ns[0]


def test_no_real_recording_gives_another_error_than_that_it_cannot_be_opened(recordings_dir: Path) -> None:
    made = 0
    for entry in entries():
        try:
            preview = _preview(recordings_dir / entry.name)
        except RecordingError:
            continue
        made += 1
        assert preview.read_share <= 1
    assert made > 100
