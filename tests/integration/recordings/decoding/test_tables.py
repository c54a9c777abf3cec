"""Tables: the fast path and the plain path return the same rows for messages of any shape."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import Recording
from kleinkram.recordings.decoding import (
    Decoder,
    NoSuchField,
    Undecodable,
    arrow_batches,
    decoder_for,
    ros_to_arrow,
    to_arrow,
    to_pandas,
    to_plain,
)
from kleinkram.recordings.sample.messages import ros2_definition
from tests.conftest import MakeCase

TEXT = """\
Header header
bool flag
float64 x
float32[3] cov
int16[] counts
uint8[] raw
string[] names
Part[] parts
Part[2] pair
Part single
builtin_interfaces/Duration lasts
bool[] flags
===
MSG: a/Part
string name
builtin_interfaces/Time at
float64[] xs
"""
LITTLE = b"\x00\x01\x00\x00"


def decoder(text: str = TEXT, name: str = "a/msg/Thing") -> Decoder:
    ros_decoder = decoder_for("cdr", name, "ros2msg", text.encode())
    assert isinstance(ros_decoder, Decoder)
    return ros_decoder


class Cdr:
    """A small writer of CDR, for tests."""

    def __init__(self) -> None:
        self.body = b""

    def put(self, code: str, *numbers: float) -> Cdr:
        size = struct.calcsize(f"<{code}")
        for number in numbers:
            self.body += b"\0" * (-len(self.body) % size) + struct.pack(f"<{code}", number)
        return self

    def text(self, text: str) -> Cdr:
        raw = text.encode() + b"\0"
        self.put("I", len(raw))
        self.body += raw
        return self

    def many(self, code: str, numbers: list[float]) -> Cdr:
        return self.put("I", len(numbers)).put(code, *numbers)

    def part(self, name: str, xs: list[float]) -> Cdr:
        return self.text(name).put("i", 5).put("I", 6).many("d", xs)


short = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=3)
short_floats = st.lists(st.integers(0, 100).map(float), max_size=2)
part = st.tuples(short, short_floats)


@st.composite
def messages_of_thing(draw: st.DrawFn) -> bytes:
    out = Cdr().put("i", draw(st.integers(-5, 5))).put("I", draw(st.integers(0, 10**9 - 1))).text(draw(short))
    out.put("B", draw(st.integers(0, 1))).put("d", draw(st.floats(allow_nan=False))).put(
        "f", 1, 2, draw(st.integers(0, 9))
    )
    out.many("h", [int(x) for x in draw(short_floats)]).many("B", [int(x) for x in draw(short_floats)])
    names = draw(st.lists(short, max_size=2))
    out.put("I", len(names))
    for name in names:
        out.text(name)
    parts = draw(st.lists(part, max_size=2))
    out.put("I", len(parts))
    for name, xs in [*parts, draw(part), draw(part), draw(part)]:
        out.part(name, xs)
    out.put("i", -1).put("I", 2).many("B", [1, 0])
    return LITTLE + out.body


def one_by_one(
    ros_decoder: Decoder, messages: list[tuple[int, int, bytes]], monkeypatch: pytest.MonkeyPatch
) -> pa.Table:
    with monkeypatch.context() as patch:
        patch.setattr(ros_to_arrow, "_MIN_ROWS", 10**9)
        return to_arrow(ros_decoder, messages)


@settings(max_examples=40, deadline=None)
@given(
    pool=st.lists(messages_of_thing(), min_size=1, max_size=3),
    order=st.lists(st.integers(0, 2), min_size=20, max_size=90),
)
def test_reading_by_shape_gives_the_same_table_as_one_by_one(pool: list[bytes], order: list[int]) -> None:
    messages = [(number, number + 1, pool[which % len(pool)]) for number, which in enumerate(order)]
    messages.insert(7, (99, 99, pool[0][:11]))
    ros_decoder = decoder()
    fast = to_arrow(ros_decoder, messages)
    with pytest.MonkeyPatch.context() as patch:
        slow = one_by_one(ros_decoder, messages, patch)
    fast.validate(full=True)
    assert fast.schema == slow.schema
    assert fast.to_pylist() == slow.to_pylist()
    row = fast.to_pylist()[-1]
    value = to_plain(ros_decoder.decode(messages[-1][2]))
    assert (row["log_time_ns"], row["publish_time_ns"]) == messages[-1][:2]
    assert row["header.stamp_ns"] == value["header"]["stamp"]["sec"] * 10**9 + value["header"]["stamp"]["nanosec"]
    assert (row["raw"], row["names"], row["cov"]) == (value["raw"], value["names"], value["cov"])
    assert [p["name"] for p in row["parts"]] == [p["name"] for p in value["parts"]]
    assert fast.to_pylist()[7] == {**dict.fromkeys(fast.column_names), "log_time_ns": 99, "publish_time_ns": 99}


def imu(number: int, frame: str = "imu") -> bytes:
    return LITTLE + Cdr().put("i", number).put("I", 5).text(frame).put("d", *range(number, number + 37)).body


IMU = decoder(ros2_definition("sensor_msgs/Imu"), "sensor_msgs/msg/Imu")


def test_imu_table() -> None:
    table = to_arrow(IMU, ((n, n, imu(n, "imu" if n % 3 else "other")) for n in range(100)))
    assert table["header.frame_id"].to_pylist()[:4] == ["other", "imu", "imu", "other"]
    assert table["header.stamp_ns"].to_pylist() == [n * 10**9 + 5 for n in range(100)]
    assert table["linear_acceleration.z"].to_pylist() == [n + 27 for n in range(100)]
    assert table["angular_velocity_covariance"].to_pylist()[1] == [float(n) for n in range(17, 26)]
    assert table.schema.field("angular_velocity_covariance").type == pa.list_(pa.float64(), 9)


def test_selecting_a_field_selects_everything_below_it() -> None:
    messages = [(n, n, imu(n)) for n in range(20)]
    table = to_arrow(IMU, messages, fields=["linear_acceleration.x", "header"])
    assert table.column_names == [
        "log_time_ns",
        "publish_time_ns",
        "header.stamp_ns",
        "header.frame_id",
        "linear_acceleration.x",
    ]
    assert to_arrow(IMU, messages, fields=["header.stamp"]).column_names[2:] == ["header.stamp_ns"]
    assert to_arrow(IMU, messages, fields=[]).column_names == ["log_time_ns", "publish_time_ns"]
    with pytest.raises(NoSuchField, match="'head'"):
        to_arrow(IMU, messages, fields=["head"])


def test_batches_are_bounded_and_at_least_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kleinkram.recordings.decoding.types.BATCH_MESSAGES", 30)
    batches = list(arrow_batches(IMU, ((n, n, imu(n)) for n in range(100))))
    assert [batch.num_rows for batch in batches] == [30, 30, 30, 10]
    small = arrow_batches(IMU, ((n, n, imu(n)) for n in range(99)), batch_bytes=1000)
    assert all(batch.num_rows == 3 for batch in small)
    empty = to_arrow(IMU, [])
    assert empty.num_rows == 0
    assert "linear_acceleration.x" in empty.column_names


def test_undecodable_messages_keep_their_row_and_are_reported() -> None:
    errors: list[int] = []
    messages = [(n, n, imu(n) if n % 10 else imu(n)[:50]) for n in range(100)]
    table = to_arrow(IMU, messages, notice=lambda log_time_ns, error: errors.append(log_time_ns))
    assert errors == list(range(0, 100, 10))
    assert table["orientation.x"].null_count == 10
    raw = to_arrow(Undecodable("x", "no schema"), [(1, 2**63, b"abc")])
    assert raw.to_pylist() == [{"log_time_ns": 1, "publish_time_ns": None, "data": b"abc"}]


def test_pandas() -> None:
    frame = to_pandas(IMU, ((n, n, imu(n)) for n in range(50)), fields=["orientation.w", "header.frame_id"])
    assert frame["orientation.w"].tolist() == [n + 3 for n in range(50)]
    assert list(frame.columns) == ["log_time_ns", "publish_time_ns", "header.frame_id", "orientation.w"]


def test_json_tables() -> None:
    ros_decoder = decoder_for("json", "Mouse", "jsonschema", b"")
    assert isinstance(ros_decoder, Decoder)
    values: list[object] = [{"p": {"x": 1}, "s": "a"}, {"p": {"x": 2.5, "y": [1]}}, 3]
    messages = [(n, n, json.dumps(value).encode()) for n, value in enumerate(values)] + [(9, 9, b"{")]
    table = to_arrow(ros_decoder, messages)
    assert table["p.x"].to_pylist() == [1, 2.5, None, None]
    assert table["p.y"].to_pylist() == [None, [1], None, None]
    assert table["value"].to_pylist() == [None, None, 3, None]
    assert to_arrow(ros_decoder, messages, fields=["p.x"]).column_names[2:] == ["p.x"]
    with pytest.raises(NoSuchField):
        to_arrow(ros_decoder, messages, fields=["q"])
    doubled = to_arrow(ros_decoder, [(0, 0, b'{"a.b": 1, "a": {"b": 2}, "log_time_ns": 3}')])
    assert doubled.column_names == ["log_time_ns", "publish_time_ns", "a.b", "a.b_", "log_time_ns_"]


@pytest.mark.parametrize(
    ("irregular", "fine", "column"),
    [
        ("18446744073709551615", ["-1", "3"], [-1, 3, None]),
        ("1e400", ["1", "2.5"], [1, 2.5, float("inf")]),
        (str(2**70), ["1", "2"], [1, 2, None]),
        ('"text"', ["1", "2"], [1, 2, None]),
        ("true", ["1", "2"], [1, 2, None]),
        ("[1]", ["1", "2"], [1, 2, None]),
        ('{"b": 1}', ["1", "2"], [1, 2, None]),
        (r'"\ud800"', ['"a"', '"b"'], ["a", "b", None]),
        ('[1, "x"]', ["[1]", "[2]"], [[1], [2], [1, None]]),
        ('{"c": "x"}', ['{"c": 1}', '{"c": 2}'], None),
        (str(2**63 + 5), ["1", "2"], [1, 2, 2**63 + 5]),
    ],
)
def test_json_value_of_another_type_is_null_and_reported(
    irregular: str, fine: list[str], column: list[object] | None
) -> None:
    ros_decoder = decoder_for("json", "Mouse", "jsonschema", b"")
    assert isinstance(ros_decoder, Decoder)
    noticed: dict[int, str] = {}
    texts = [*fine, irregular]
    messages = [(n, n, f'{{"a": {text}, "s": 0.5}}'.encode()) for n, text in enumerate(texts)]
    table = to_arrow(ros_decoder, messages, notice=lambda time, error: noticed.update({time: str(error)}))
    assert table["s"].to_pylist() == [0.5] * 3
    if column is None:
        assert table["a.c"].to_pylist() == [1, 2, None]
    else:
        assert table["a"].to_pylist() == column
    is_null = column is None or column[-1] is None or column[-1] == [1, None]
    assert [*noticed] == ([2] if is_null else [])
    assert not is_null or "'a" in noticed[2]


@pytest.mark.parametrize(
    ("texts", "column", "irregular"),
    [
        (["1", "2", '"x"', '"y"', "5", "6"], [1, 2, None, None, 5, 6], [2, 3]),
        (["-1", "2", str(2**63 + 5), "3"], [-1, 2, None, 3], [2]),
        (["1", "2", str(2**63 + 5), "3"], [1, 2, 2**63 + 5, 3], []),
        ([str(2**53 + 2), "2", "0.5", "3"], [2**53 + 2, 2, 0.5, 3], []),
        (["0.5", "2", str(2**60), "3"], [0.5, 2, 2**60, 3], []),
        (["true", "false", "false", "2", "true"], [True, False, False, None, True], [3]),
        (["[1]", "[2]", "[3]", '["x"]'], [[1], [2], [3], [None]], [3]),
        (['"a"', "null", "7", "null", '"b"'], ["a", None, None, None, "b"], [2]),
    ],
)
def test_json_types_that_change_between_batches_give_one_table(
    texts: list[str], column: list[object], irregular: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kleinkram.recordings.decoding.types.BATCH_MESSAGES", 2)
    ros_decoder = decoder_for("json", "Mouse", "jsonschema", b"")
    assert isinstance(ros_decoder, Decoder)
    noticed: list[int] = []
    messages = [(n, n, f'{{"a": {text}}}'.encode()) for n, text in enumerate(texts)]
    table = to_arrow(ros_decoder, messages, notice=lambda time, _: noticed.append(time))
    assert table["a"].to_pylist() == column
    assert noticed == irregular


def test_json_integer_beyond_int64_does_not_break_the_table(make_case: Callable[[str], Path]) -> None:
    with Recording.open(next(make_case("14A").glob("**/*.mcap"))) as recording:
        assert recording.to_arrow("/detections")["id"].to_pylist() == [1, 2**63 + 5, 3]


def test_definitions_that_differ_in_comments_give_one_table(make_case: Callable[[str], Path]) -> None:
    with Recording.open(next(make_case("10A").glob("**/*.mcap"))) as recording:
        assert recording.to_arrow("/t")["x"].to_pylist() == [*range(12)]
        assert recording.problems == ()


def test_a_layout_depends_on_fields_only() -> None:
    rule = "=" * 80
    texts = [
        f"A a\nB b\n{rule}\nMSG: p/A\nint32 x\n{rule}\nMSG: p/B\nint8 y\n",
        f"# of it\n  p/A  a # first\nB b\n\n{rule}\nMSG: p/B\nint8 y\n{rule}\nMSG: p/A\nint32 x\n",
        f"A a\nB b\n{rule}\nMSG: p/A\nint64 x\n{rule}\nMSG: p/B\nint8 y\n",
    ]
    one, same, other = (decoder_for("cdr", "p/msg/T", "ros2msg", text.encode()) for text in texts)
    assert isinstance(one, Decoder)
    assert isinstance(same, Decoder)
    assert isinstance(other, Decoder)
    assert one.layout == same.layout != other.layout


def test_a_bag_without_definitions_reports_them_as_missing(make_case: Callable[[str], Path]) -> None:
    with Recording.open(next(make_case("09A").glob("**/*.bag"))) as recording:
        reasons = {topic.name: topic.undecodable for topic in recording.topics}
        assert reasons.pop("/e") is None
        assert all(reason and "definition is missing" in reason for reason in reasons.values())
        assert recording.to_arrow("/n")["data"].to_pylist() == [b"\x07\0\0\0"]


def test_repeated_fields_of_protobuf_become_lists(make_case: MakeCase) -> None:
    assert "'list', 'subs': 'list', 'names': 'list'" in (make_case("19A") / "printed.txt").read_text()
