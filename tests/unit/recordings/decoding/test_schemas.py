"""Schemas of every language are parsed; unsupported ones are named."""

from __future__ import annotations

import struct
import time

import pytest
from google.protobuf import descriptor_pb2, timestamp_pb2

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, decoder_for, stamp_ns, to_plain

RULE = "=" * 80
LITTLE = b"\x00\x01\x00\x00"
IDL = f"""{RULE}
IDL: demo_msgs/msg/Scan
// generated from rosidl_adapter/resource/msg.idl.em
// with input from demo_msgs/msg/Scan.msg
#include "std_msgs/msg/Header.idl"

module demo_msgs {{
  module msg {{
    typedef double double__3[3];
    typedef std_msgs::msg::Header Header__2[2];
    module Scan_Constants {{
      const uint8 MODE_FAST = 1;
      const string<4> UNIT = "m";
      const float HALF = -0.5f;
      const boolean YES = TRUE;
      const unsigned long SUM = 1 + 2;
    }};
    @bit_bound(8)
    enum Kind {{ @default_literal NONE, SOME }};
    const long N = 2;
    @verbatim (language="comment", text=
      "A scan (of sorts); it's \\"quoted\\"." "\\n" "Second line.")
    struct Scan {{
      std_msgs::msg::Header header;
      @unit (value="m")
      double__3 position;
      Header__2 others;
      sequence<float, 10> ranges;
      sequence<string<5>> names;
      @default (value=7)
      unsigned short a, b[2][3];
      long long _long;
      Kind kind;
      octet tail[N];
    }};
  }};
}};

{RULE}
IDL: std_msgs/msg/Header
module std_msgs {{ module msg {{ /* inside */
    struct Header {{ builtin_interfaces::msg::Time stamp; string frame_id; }};
}}; }};
{RULE}
IDL: builtin_interfaces/msg/Time
module builtin_interfaces {{ module msg {{ struct Time {{ int32 sec; uint32 nanosec; }}; }}; }};
"""


def idl(text: str, name: str = "demo_msgs/msg/Scan") -> Decoder | Undecodable:
    return decoder_for("cdr", name, "ros2idl", text.encode())


def reason(answer: Decoder | Undecodable) -> str:
    assert isinstance(answer, Undecodable)
    return answer.reason


def test_idl_as_rosidl_writes_it() -> None:
    decoder = idl(IDL)
    assert isinstance(decoder, Decoder)
    body = struct.pack("<iII2s2x", 1, 2, 2, b"f\0") + struct.pack("<3d", 1, 2, 3)
    body += struct.pack("<iII2s2x", 3, 4, 2, b"g\0") * 2
    body += struct.pack("<IfIIs", 1, 0.5, 1, 1, b"\0") + b"\0" + struct.pack("<7H", 7, 1, 2, 3, 4, 5, 6)
    body += b"\0" * (-len(body) % 8) + struct.pack("<qB2B", -9, 1, 8, 9)
    value = decoder.decode(LITTLE + body)
    header = {"stamp": {"sec": 3, "nanosec": 4}, "frame_id": "g"}
    assert to_plain(value) == {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "f"},
        "position": [1.0, 2.0, 3.0],
        "others": [header, header],
        "ranges": [0.5],
        "names": [""],
        "a": 7,
        "b": [[1, 2, 3], [4, 5, 6]],
        "long": -9,
        "kind": 1,
        "tail": b"\x08\x09",
    }
    constants = {name: getattr(value, name, None) for name in ("MODE_FAST", "UNIT", "HALF", "YES", "SUM")}
    assert constants == {"MODE_FAST": 1, "UNIT": "m", "HALF": -0.5, "YES": True, "SUM": None}


def test_idl_and_msg_give_the_same_values() -> None:
    as_idl = idl("module a { module msg { struct B { double x; string s; }; }; };", "a/msg/B")
    as_msg = decoder_for("cdr", "a/msg/B", "ros2msg", b"float64 x\nstring s")
    data = LITTLE + struct.pack("<dI2s", 1.5, 2, b"x\0")
    assert isinstance(as_idl, Decoder)
    assert isinstance(as_msg, Decoder)
    assert as_idl.decode(data) == as_msg.decode(data)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("union U switch (long) { case 1: long x; };", "union"),
        ("struct S { @optional long x; };", "optional"),
        ("struct T { long x; }; struct S : T { };", "inherits"),
        ("struct S { long double x; };", "long double"),
        ("struct S { map<long, long> x; };", "map"),
        ("struct S { S x; };", "contains itself"),
        ("struct S { sequence<S> x; };", "contains itself"),
        ("typedef A B; typedef B A; struct S { A x; };", "typedefs"),
        ("struct S { Missing x; };", "not defined"),
        ("struct S { long x[y]; };", "not a length"),
        ("struct S { long x", "ends in the middle"),
        ("struct S { long x; long x; };", "two fields"),
        ("struct S { long __class__; };", "not a name"),
        ("struct S { long x[99999999999]; };", "99999999999 elements"),
        ("struct T { long x; };", "does not define"),
        ("/* no end", "comment"),
        ("struct S { \x00 };", "not IDL"),
        ("module m {" * 30, "nest more than"),
        ("struct S { " + "sequence<" * 40 + "long", "nest more than"),
        ("struct S { 3 x; };", "not a type"),
        ("@bit_bound(64) enum E { A }; struct S { E x; };", "32 bits"),
        ("nonsense", "not a declaration"),
    ],
)
def test_invalid_idl_is_refused(text: str, word: str) -> None:
    assert word in reason(idl(text, "S"))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("Thing[] x", "contains itself"),
        ("Other x\n===\nMSG: a/Other\nThing y", "contains itself"),
        ("Missing x", "not defined"),
        ("int32 x\nint64 x", "two fields"),
        ("int32 _x", "not a name"),
        ("int32 x; import os", None),
        ("int32 (x)", "is no field"),
        ("int32[99999999999] x", "99999999999 elements"),
        ("int32 a\n---\nint32 b\n---\nint32 c", "actions"),
        ("\n".join(f"int32 x{number}" for number in range(7000)), "fields"),
        ("L1 x\n" + "\n".join(f"===\nMSG: a/L{n}\nL{n + 1} x" for n in range(1, 40)), "nest more than"),
        ("L1 x\n" + "\n".join(f"===\nMSG: a/L{n}\nL{n + 1}[] x" for n in range(1, 20)) + "\n===\nMSG: a/L20\n", "deep"),
        ("L1 x\n" + "\n".join(f"===\nMSG: a/L{n}\n" + f"L{n + 1} x\nL{n + 1} y" for n in range(1, 20)), "not defined"),
        ("int32 " + "x" * 300, "not a name"),
        ("wstring s", None),
        ("int8 x\n" + "===\nMSG: a/T\n" * 2001, "more than 2000 types"),
        (" " * (2 * 2**20 + 1), "at most"),
    ],
)
def test_invalid_msg_is_refused(text: str, word: str | None) -> None:
    answer = decoder_for("cdr", "a/Thing", "ros2msg", text.encode())
    if word is None:
        assert isinstance(answer, Decoder)
    else:
        assert word in reason(answer)


def test_total_number_of_nested_fields_is_bounded() -> None:
    text = (
        "L1 x\n" + "\n".join(f"===\nMSG: a/L{n}\nL{n + 1} x\nL{n + 1} y" for n in range(1, 18)) + "\n===\nMSG: a/L18\n"
    )
    assert "more than 6000 fields" in reason(decoder_for("ros1", "a/Thing", "ros1msg", text.encode()))


@pytest.mark.parametrize("text", ["/*" * 500_000, '"' * 500_000, "@" * 300_000, "a" * 1_000_000, "[" * 500_000])
def test_hostile_texts_are_refused_quickly(text: str) -> None:
    start = time.thread_time()
    assert isinstance(idl(text, "S"), Undecodable)
    assert isinstance(decoder_for("cdr", "a/S", "ros2msg", text.encode()), Undecodable)
    assert time.thread_time() - start < 2


def test_a_type_used_by_many_fields_is_resolved_once() -> None:
    inner = "".join(f" long f{number};" for number in range(900))
    many = "".join(f" T a{number};" for number in range(900))
    constants = "".join(f" const long c{number} = 1;" for number in range(2_000))
    text = f"struct T {{{inner} }}; struct S {{{many} }}; module T_Constants {{{constants} }};"
    start = time.thread_time()
    assert "more than 6000 fields" in reason(idl(text, "S"))
    assert time.thread_time() - start < 1  # 0.05 s; 4.5 s where each mention builds it anew


def test_repeated_typedefs_do_not_multiply_dimensions() -> None:
    text = "typedef long T" + "[1]" * 20_000 + "; struct S {" + "".join(f" T a{n};" for n in range(5_000)) + " };"
    assert "dimensions" in reason(idl(text, "S"))


def test_ros1_has_no_wstring() -> None:
    assert "not defined" in reason(decoder_for("ros1", "a/Thing", "ros1msg", b"wstring s"))


def test_schema_text_never_becomes_code() -> None:
    text = "int32 class\nint32 def\nint32 decode\nint32 o\nint32 data\nint32 v0\nint32 size"
    decoder = decoder_for("ros1", "a/B'); import os #", "ros1msg", text.encode())
    assert isinstance(decoder, Decoder)
    assert to_plain(decoder.decode(struct.pack("<7i", *range(7)))) == dict(
        zip(("class_", "def_", "decode", "o", "data", "v0", "size"), range(7), strict=True)
    )


def test_json() -> None:
    decoder = decoder_for("json", "Mouse", "jsonschema", b"{}")
    assert isinstance(decoder, Decoder)
    value = decoder.decode(b'{"timestamp": {"sec": 1, "nsec": 2}, "x": [1, "\xc3\xa4", null]}')
    assert to_plain(value) == {"timestamp": {"sec": 1, "nsec": 2}, "x": [1, "ä", None]}
    assert stamp_ns(value) == 1_000_000_002
    for wrong in (b"{", b"\xff\xfe\x00", b"[" * 100_000, b"1" * 10_000, b"", b"[,]"):
        with pytest.raises(DecodeError):
            decoder.decode(wrong)
    with pytest.raises(DecodeError, match="values"):
        decoder.decode(b"[" + b"{}," * 1_500_000 + b"1]")


def descriptor_set(*, with_time: bool) -> bytes:
    """A type with a time, a list, bytes, a oneof and a map; its file stands before what it imports."""
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="demo.proto", package="demo", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    kind = file.message_type.add(name="Pose")
    field = descriptor_pb2.FieldDescriptorProto
    kind.field.add(name="timestamp", number=1, type=field.TYPE_MESSAGE, label=1, type_name=".google.protobuf.Timestamp")
    kind.field.add(name="xs", number=2, type=field.TYPE_DOUBLE, label=3)
    kind.field.add(name="raw", number=3, type=field.TYPE_BYTES, label=1)
    if with_time:
        described = files.file.add()
        timestamp_pb2.DESCRIPTOR.CopyToProto(described)
    return bytes(files.SerializeToString())


@pytest.mark.parametrize("with_time", [True, False])
def test_protobuf(with_time: bool) -> None:
    decoder = decoder_for("protobuf", "demo.Pose", "protobuf", descriptor_set(with_time=with_time))
    assert isinstance(decoder, Decoder)
    data = b"\x0a\x04\x08\x05\x10\x06" + b"\x12\x10" + struct.pack("<2d", 1.5, 2.5) + b"\x1a\x02hi"
    value = decoder.decode(data)
    assert to_plain(value) == {"timestamp": {"seconds": 5, "nanos": 6}, "xs": [1.5, 2.5], "raw": b"hi"}
    assert stamp_ns(value) == 5_000_000_006
    assert to_plain(decoder.decode(b"")) == {"xs": [], "raw": b""}
    with pytest.raises(DecodeError, match="not such a protobuf"):
        decoder.decode(b"\x0a\x7f")


def test_invalid_protobuf_schemas_are_refused() -> None:
    assert "FileDescriptorSet" in reason(decoder_for("protobuf", "demo.Pose", "protobuf", b"\xff"))
    assert "inconsistent" in reason(decoder_for("protobuf", "demo.Missing", "protobuf", descriptor_set(with_time=True)))
    files = descriptor_pb2.FileDescriptorSet()
    files.file.add(name="a.proto").dependency.append("b.proto")
    assert "needs b.proto" in reason(decoder_for("protobuf", "A", "protobuf", files.SerializeToString()))
    files.file.add(name="b.proto").dependency.append("a.proto")
    assert isinstance(decoder_for("protobuf", "A", "protobuf", files.SerializeToString()), Undecodable)
