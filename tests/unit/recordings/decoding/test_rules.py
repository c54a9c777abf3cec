"""Every rule of the wire formats with handmade bytes."""

from __future__ import annotations

import copy
import pickle
import struct

import numpy as np
import pytest

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, decoder_for, stamp_ns, to_plain
from kleinkram.recordings.decoding.values import Value

LITTLE = b"\x00\x01\x00\x00"
BIG = b"\x00\x00\x00\x00"
LITTLE_XCDR2 = b"\x00\x07\x00\x00"


def ros2(text: str, name: str = "test_msgs/msg/Thing") -> Decoder:
    decoder = decoder_for("cdr", name, "ros2msg", text.encode())
    assert isinstance(decoder, Decoder), decoder
    return decoder


def ros1(text: str, name: str = "test_msgs/Thing") -> Decoder:
    decoder = decoder_for("ros1", name, "ros1msg", text.encode())
    assert isinstance(decoder, Decoder), decoder
    return decoder


def plain(decoder: Decoder, data: bytes) -> object:
    return to_plain(decoder.decode(data))


def test_alignment_counts_from_after_the_header() -> None:
    decoder = ros2("uint8 a\nfloat64 b\nuint8 c\nuint16 d\nuint32 e")
    body = struct.pack("<B7xdBxHI", 1, 2.5, 3, 4, 5)
    assert plain(decoder, LITTLE + body) == {"a": 1, "b": 2.5, "c": 3, "d": 4, "e": 5}
    big = struct.pack(">B7xdBxHI", 1, 2.5, 3, 4, 5)
    assert plain(decoder, BIG + big) == {"a": 1, "b": 2.5, "c": 3, "d": 4, "e": 5}


def test_xcdr2_aligns_to_four_at_most() -> None:
    decoder = ros2("uint8 a\nfloat64 b\nint64[] c\nstring[] d")
    names = struct.pack("<III2s", 10, 1, 2, b"x\0")
    body = struct.pack("<B3xdIq", 1, 2.5, 1, -7) + names
    assert plain(decoder, LITTLE_XCDR2 + body) == {"a": 1, "b": 2.5, "c": [-7], "d": ["x"]}


@pytest.mark.parametrize("text", ["", "a", "ab", "abc", "abcd", "äöü"])
def test_alignment_behind_a_text(text: str) -> None:
    decoder = ros2("string s\nfloat64 x\nstring t\nuint16 y")
    raw = text.encode() + b"\0"
    body = struct.pack("<I", len(raw)) + raw
    body += b"\0" * (-len(body) % 8) + struct.pack("<d", 1.5) + struct.pack("<I", len(raw)) + raw
    body += b"\0" * (-len(body) % 2) + struct.pack("<H", 9)
    assert plain(decoder, LITTLE + body) == {"s": text, "x": 1.5, "t": text, "y": 9}


def test_ros1_aligns_nothing_and_counts_no_nul() -> None:
    decoder = ros1("uint8 a\nfloat64 b\nstring s\nbyte c\nchar d\ntime t\nduration u\nbool[] f")
    body = struct.pack("<BdI2sbBIIiiI3B", 1, 2.5, 2, b"hi", -1, 200, 7, 8, -9, 10, 3, 0, 1, 2)
    assert plain(decoder, body) == {
        "a": 1,
        "b": 2.5,
        "s": "hi",
        "c": -1,
        "d": 200,
        "t": {"secs": 7, "nsecs": 8},
        "u": {"secs": -9, "nsecs": 10},
        "f": [False, True, True],
    }


def test_byte_and_char_are_unsigned_in_ros2() -> None:
    assert plain(ros2("byte a\nchar b"), LITTLE + b"\xff\xfe") == {"a": 255, "b": 254}


def test_bounds_and_defaults_do_not_affect_the_bytes() -> None:
    decoder = ros2(
        'int32 X=5\nstring<=10 a "x=1 # no comment"\nint32[<=5] b [1, 2]\nstring<=3[<=2] c\nint32[2] d  # two'
    )
    body = struct.pack("<I4sIiII4sii", 4, b"abc\0", 1, -1, 1, 4, b"xyz\0", 1, 2)
    value = decoder.decode(LITTLE + body)
    assert to_plain(value) == {"a": "abc", "b": [-1], "c": ["xyz"], "d": [1, 2]}
    assert getattr(value, "X") == 5  # noqa: B009  # the attribute exists at run time only


def test_constants_are_read_as_their_type() -> None:
    text = (
        'bool T=True\nfloat32 F = 1.5 # c\nstring S=a # b\nstring Q="q"\nuint8 H=0x10\nint8 BAD=x\nint8 class=1\nint8 v'
    )
    value = ros2(text).decode(LITTLE + b"\x01")
    constants = {name: getattr(value, name, None) for name in ("T", "F", "S", "Q", "H", "BAD", "class_")}
    assert constants == {"T": True, "F": 1.5, "S": "a # b", "Q": "q", "H": 16, "BAD": None, "class_": 1}


@pytest.mark.parametrize("order", ["<", ">"])
def test_arrays_of_numbers(order: str) -> None:
    decoder = ros2("float64[] a\nuint16[3] b\nbool[2] c\nint64[] d\nuint8 e")
    header = LITTLE if order == "<" else BIG
    body = struct.pack(f"{order}I4x2d3H2BI4xqB", 2, 1.5, -2.5, 1, 2, 3, 0, 5, 1, 77, 9)
    value = decoder.decode(header + body)
    assert to_plain(value) == {"a": [1.5, -2.5], "b": [1, 2, 3], "c": [False, True], "d": [77], "e": 9}
    array = value.a  # type: ignore[attr-defined]  # the attribute exists at run time only
    assert isinstance(array, np.ndarray)
    assert array.dtype == np.dtype(f"{order}f8")
    assert not array.flags.writeable


def test_empty_arrays_are_not_aligned() -> None:
    decoder = ros2("float64[] a\nuint32 b\nfloat64[0] c\nuint8 d")
    assert plain(decoder, LITTLE + struct.pack("<IIB", 0, 7, 1)) == {"a": [], "b": 7, "c": [], "d": 1}


def test_arrays_of_types_align_each_element() -> None:
    text = "Part[] parts\nuint8 z\n" + "=" * 80 + "\nMSG: test_msgs/Part\nuint8 a\nfloat64 b\nuint8[] c"
    body = struct.pack("<IB3xdI2s", 2, 1, 1.5, 2, b"\7\x08") + struct.pack("<BxdIB", 2, 2.5, 0, 9)
    expected = {"parts": [{"a": 1, "b": 1.5, "c": b"\7\x08"}, {"a": 2, "b": 2.5, "c": b""}], "z": 9}
    assert plain(ros2(text), LITTLE + body) == expected


def test_a_type_without_fields_has_one_byte_in_cdr_and_none_in_ros1() -> None:
    text = "Empty[2] e\nuint8 z\n===\nMSG: test_msgs/Empty\n"
    assert plain(ros2(text), LITTLE + b"\0\0\x07") == {"e": [{}, {}], "z": 7}
    assert plain(ros1(text), b"\x07") == {"e": [{}, {}], "z": 7}
    assert plain(ros2("# nothing"), LITTLE) == {}
    assert plain(ros1("# nothing"), b"") == {}


def test_wide_texts_of_both_layouts() -> None:
    decoder = ros2("wstring s\nuint32 z")
    four = "hé𝄞".encode("utf-32-le")
    assert plain(decoder, LITTLE + struct.pack("<I", 3) + four + struct.pack("<I", 5)) == {"s": "hé𝄞", "z": 5}
    two = "héllo!".encode("utf-16-le")
    assert plain(decoder, LITTLE + struct.pack("<I", 12) + two + struct.pack("<I", 5)) == {"s": "héllo!", "z": 5}
    assert plain(decoder, LITTLE + struct.pack("<II", 0, 5)) == {"s": "", "z": 5}


def test_texts_that_are_not_utf8_stay_readable() -> None:
    assert plain(ros1("string s"), struct.pack("<I2s", 2, b"a\xff")) == {"s": "a�"}


def test_service_events() -> None:
    decoder = ros2("int64 a\n---\nint64 sum", "demo/srv/Add_Event")
    info = struct.pack("<B3xiI16s4xq", 1, 5, 6, bytes(16), 42)
    body = info + struct.pack("<I4xqI", 1, 7, 0)
    assert plain(decoder, LITTLE + body) == {
        "info": {
            "event_type": 1,
            "stamp": {"sec": 5, "nanosec": 6},
            "client_gid": bytes(16),
            "sequence_number": 42,
        },
        "request": [{"a": 7}],
        "response": [],
    }
    assert plain(ros2("int64 a\n---\nint64 sum", "demo/srv/Add_Response"), LITTLE + struct.pack("<q", 3)) == {"sum": 3}


def test_a_value_compares_prints_copies_and_pickles() -> None:
    decoder = ros2("uint8[] data\nstring from\nHeader header", "test_msgs/msg/Thing")
    body = struct.pack("<I1s3xI2s2xiII2s", 1, b"\x05", 2, b"x\0", 3, 4, 2, b"m\0")
    value = decoder.decode(LITTLE + body)
    assert isinstance(value, Value)
    assert value == decoder.decode(LITTLE + body)
    assert value != decoder.decode(LITTLE + body.replace(b"x\0", b"y\0"))
    assert value != 3
    assert pickle.loads(pickle.dumps(value)) == value
    assert copy.deepcopy(value) == value
    assert repr(value).startswith("test_msgs/msg/Thing(data=array([5], dtype=uint8), from_='x', header=std_msgs/msg/He")
    assert stamp_ns(value) == 3_000_000_004


@pytest.mark.parametrize(
    ("encoding", "reason"),
    [(3, "PL_CDR (little-endian)"), (9, "D_CDR2 (little-endian)"), (77, "number 77")],
)
def test_unsupported_encapsulations_are_named_in_the_error(encoding: int, reason: str) -> None:
    with pytest.raises(DecodeError, match="not decoded") as caught:
        ros2("uint8 a").decode(bytes([0, encoding, 0, 0, 1]))
    assert reason in str(caught.value)
    with pytest.raises(DecodeError, match="start with a CDR header"):
        ros2("uint8 a").decode(b"\x00\x01")


def test_undecodable_schema_has_a_reason() -> None:
    answer = decoder_for("cdr", "a/msg/B", "flatbuffer", b"x")
    assert answer == Undecodable("a/msg/B", "messages encoded as 'cdr' with a schema in 'flatbuffer' are not decoded")
