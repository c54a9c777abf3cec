"""Bins: extreme values whatever the batches; bounded numbers of bins, samples and fields."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kleinkram.recordings.previews import bins, tracks
from kleinkram.recordings.previews.bins import BinnedFields, FieldBudget, halved
from kleinkram.recordings.previews.model import TopicSeries
from kleinkram.recordings.previews.samples import EvenSamples
from kleinkram.recordings.previews.tracks import PositionSampler

_NUMBERS = st.floats(allow_nan=True, width=32)


def _series(batches: list[list[float]], name: str = "x") -> TopicSeries:
    fields, at = BinnedFields(FieldBudget(10)), 0
    for batch in batches:
        fields.add(np.arange(at, at + len(batch)), {name: np.array(batch, np.float64)})
        at += len(batch)
    return fields.series("/topic", "a/B", is_sampled=False)


@given(batches=st.lists(st.lists(_NUMBERS, max_size=30), max_size=8))
def test_each_bin_has_the_extremes_of_its_messages(batches: list[list[float]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bins, "MAX_BINS", 8)
        series = _series(batches)
    values = np.array([number for batch in batches for number in batch], np.float64)
    assert series.message_count == len(values)
    assert len(series.first_ns) <= 8
    if np.isnan(values).all():
        assert series.fields == ()
        return
    per_bin = series.messages_per_bin
    parts = [values[start : start + per_bin] for start in range(0, len(values), per_bin)]
    expected_low = [np.fmin.reduce(part) for part in parts]
    expected_high = [np.fmax.reduce(part) for part in parts]
    np.testing.assert_array_equal(series.fields[0].low, expected_low)
    np.testing.assert_array_equal(series.fields[0].high, expected_high)
    np.testing.assert_array_equal(series.first_ns, np.arange(0, len(values), per_bin))
    np.testing.assert_array_equal(series.last_ns, [min(n + per_bin, len(values)) - 1 for n in series.first_ns])


def test_half_as_many_bins_have_the_same_extremes() -> None:
    series = _series([[3.0, 1.0, 2.0, 5.0, -1.0]])
    coarse = halved(halved(series))
    assert coarse.messages_per_bin == 4
    assert coarse.fields[0].low.tolist() == [1, -1]
    assert coarse.fields[0].high.tolist() == [5, -1]
    assert coarse.last_ns.tolist() == [3, 4]


def test_a_million_messages_have_at_most_four_thousand_bins() -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(size=1_000_000)
    series = _series([list(part) for part in np.split(values, 50)])
    assert bins.MAX_BINS / 2 <= len(series.first_ns) <= bins.MAX_BINS
    assert (series.fields[0].low.min(), series.fields[0].high.max()) == (values.min(), values.max())


def test_a_field_that_comes_later_has_no_numbers_before() -> None:
    fields = BinnedFields(FieldBudget(10))
    fields.add(np.arange(2), {"x": np.array([1.0, 2.0])})
    fields.add(np.arange(2, 4), {"x": np.array([3.0, 4.0]), "y": np.array([5.0, 6.0])})
    (x, y) = fields.series("/t", "a/B", is_sampled=False).fields
    assert x.low.tolist() == [1, 2, 3, 4]
    assert np.isnan(y.low[:2]).all()
    assert y.high[2:].tolist() == [5, 6]


def test_topics_share_a_budget_of_fields() -> None:
    budget = FieldBudget(3)
    one, other = BinnedFields(budget), BinnedFields(budget)
    columns = {name: np.ones(1) for name in ("x", "y")}
    one.add(np.zeros(1, np.int64), columns)
    other.add(np.zeros(1, np.int64), columns)
    assert len(one.series("/1", "", is_sampled=False).fields) == 2
    assert len(other.series("/2", "", is_sampled=False).fields) == 1
    assert (one.left_out_fields, other.left_out_fields) == (False, True)


@pytest.mark.parametrize("expected_count", [None, 0, 1000, 10**12])
def test_samples_are_bounded_and_even(expected_count: int | None) -> None:
    samples: EvenSamples[int] = EvenSamples(60, expected_count)
    for number in range(1000):
        if samples.takes_next():
            samples.add(number)
    assert samples.count == 1000
    if expected_count == 10**12:  # a wrong index leaves the first
        assert samples.items == [0]
        return
    assert 30 <= len(samples.items) <= 60
    assert len(set(np.diff(samples.items))) == 1


def test_a_track_is_thinned_and_ends_where_the_robot_was_last() -> None:
    sampler = PositionSampler("/gnss", is_pose=False)
    for start in range(0, 50_000, 100):
        steps = np.arange(start, start + 100, dtype=np.float64)
        columns = {"latitude": steps / 1e6, "longitude": steps / 1e5, "altitude": np.full(100, np.nan)}
        sampler.add(steps.astype(np.int64), {**columns, "status.status": np.where(steps == 7, -1, 0)})
    track = sampler.track()
    assert track is not None
    assert track.message_count == 49_999, "one had no fix"
    assert tracks.MAX_POSITIONS / 2 <= len(track.times_ns) <= tracks.MAX_POSITIONS + 1
    assert (track.times_ns[0], track.times_ns[-1]) == (0, 49_999)
    assert track.positions[-1, 1] == 0.49999


def test_no_usable_position_is_no_track() -> None:
    sampler = PositionSampler("/pose", is_pose=True)
    sampler.add(np.arange(2), {"pose.position.x": np.array([np.nan, np.inf]), "pose.position.y": np.zeros(2)})
    assert sampler.track() is None
    other = PositionSampler("/imu", is_pose=False)
    other.add(np.arange(1), {"pose.position.x": np.zeros(1), "pose.position.y": np.zeros(1)})
    assert other.track() is None
