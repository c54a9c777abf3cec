"""Any bytes yield a value or a `DecodeError`, in bounded time and memory."""

from __future__ import annotations

import struct
import time
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, decoder_for, to_plain
from tests.memory import call_within

EVERYTHING = """\
bool a
string b
uint8[] c
float64[] d
string[] e
Part[] f
Part[2] g
int64[3] h
bool[] i
Nothing[] j
wstring k
wstring[] l
Header m
===
MSG: a/Part
string name
float64 x
Nothing none
float32[] ys
===
MSG: a/Nothing
"""
ENCODINGS = [("cdr", "ros2msg"), ("ros1", "ros1msg")]


@cache
def decoder(message_encoding: str, schema_encoding: str, text: str = EVERYTHING) -> Decoder:
    if message_encoding == "ros1":
        text = text.replace("wstring", "string")
    message_decoder = decoder_for(message_encoding, "a/Thing", schema_encoding, text.encode())
    assert isinstance(message_decoder, Decoder), message_decoder
    return message_decoder


def answers(message_decoder: Decoder, data: bytes) -> object:
    """Decode; a DecodeError is an answer, anything else fails the test."""
    try:
        return to_plain(message_decoder.decode(data))
    except DecodeError as error:
        return str(error)


lengths = st.integers(0, 5).map(lambda n: struct.pack("<I", n)) | st.sampled_from(
    [b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\x00\x00\x01\x00"]
)
bodies = st.lists(lengths | st.binary(max_size=9), max_size=40).map(b"".join)
headers = st.sampled_from([bytes([0, kind, 0, 0]) for kind in (0, 1, 6, 7, 2, 99)])


@settings(max_examples=250, deadline=None)
@given(header=headers, body=bodies)
def test_any_cdr_bytes(header: bytes, body: bytes) -> None:
    answers(decoder("cdr", "ros2msg"), header + body)


@settings(max_examples=150, deadline=None)
@given(body=bodies)
def test_any_ros1_bytes(body: bytes) -> None:
    answers(decoder("ros1", "ros1msg"), body)


MSG_WORDS = "int32 float64 string Header Thing x y [3] [] [<=4] <=5 = --- === MSG: a/Thing MSG:a/B time # ' \" \n"
words = st.sampled_from(MSG_WORDS.split(" ")) | st.just("\n") | st.text(max_size=6)


@settings(max_examples=150, deadline=None)
@given(text=st.lists(words, max_size=30).map(" ".join), body=bodies)
def test_any_msg_text(text: str, body: bytes) -> None:
    for message_encoding, schema_encoding in ENCODINGS:
        message_decoder = decoder_for(message_encoding, "a/Thing", schema_encoding, text.encode("utf-8", "replace"))
        if isinstance(message_decoder, Decoder):
            answers(message_decoder, b"\0\1\0\0" + body)


IDL_WORDS = (
    "module struct typedef enum const sequence < > { } ( ) [ ] ; , = @ :: a S x long double string 3 0x1f 1.5e3 / // \n"
)
idl_words = st.sampled_from(IDL_WORDS.split(" ")) | st.text(max_size=4)


@settings(max_examples=200, deadline=None)
@given(text=st.lists(idl_words, max_size=40).map(" ".join))
def test_any_idl_text(text: str) -> None:
    assert isinstance(decoder_for("cdr", "S", "ros2idl", text.encode("utf-8", "replace")), (Decoder, Undecodable))
    whole = f"struct S {{ long x; }}; {text}"
    assert isinstance(decoder_for("cdr", "S", "ros2idl", whole.encode("utf-8", "replace")), (Decoder, Undecodable))


@settings(max_examples=150, deadline=None)
@given(data=st.binary(max_size=200))
def test_any_json_and_protobuf_bytes(data: bytes) -> None:
    message_decoder = decoder_for("json", "a", "", b"")
    assert isinstance(message_decoder, Decoder)
    answers(message_decoder, data)
    assert isinstance(decoder_for("protobuf", "a", "protobuf", data), (Decoder, Undecodable))


@pytest.mark.parametrize(("message_encoding", "schema_encoding"), ENCODINGS)
@pytest.mark.parametrize(
    "text",
    [
        "Nothing[] x",
        "Nothing[2000000000] x",
        "string[] x",
        "float64[] x",
        "uint8[] x",
        "string x",
        "Many[] x",
        "bool[] x",
    ],
)
def test_length_of_four_billion_allocates_nothing(message_encoding: str, schema_encoding: str, text: str) -> None:
    text += "\n===\nMSG: a/Nothing\n===\nMSG: a/Many\n" + "\n".join(f"Nothing x{n}" for n in range(500))
    message_decoder = decoder(message_encoding, schema_encoding, text)
    data = (
        b"\0\1\0\0" + b"\xff\xff\xff\xff" + bytes(40) if message_encoding == "cdr" else b"\xff\xff\xff\xff" + bytes(40)
    )

    def decode() -> None:
        with pytest.raises(DecodeError):
            message_decoder.decode(data)

    start = time.thread_time()
    call_within(2**20, decode)
    assert time.thread_time() - start < 1


@pytest.mark.parametrize(("message_encoding", "schema_encoding"), ENCODINGS)
def test_objects_per_message_are_bounded(message_encoding: str, schema_encoding: str) -> None:
    text = "Many[] x\n===\nMSG: a/Nothing\n===\nMSG: a/Many\nuint8 y\n" + "\n".join(f"Nothing x{n}" for n in range(500))
    message_decoder = decoder(message_encoding, schema_encoding, text)
    head = b"\0\1\0\0" if message_encoding == "cdr" else b""
    with pytest.raises(DecodeError, match="claimed"):
        message_decoder.decode(head + struct.pack("<I", 4000) + bytes(4_000_000))


@pytest.mark.parametrize("name", ["pkg/a\x00b", "pkg/", "pkg/two words", "pkg/\udcff"])
def test_type_with_an_invalid_name(name: str) -> None:
    message_decoder = decoder_for("ros1", name, "ros1msg", b"int8 x")
    assert isinstance(message_decoder, Decoder)
    assert to_plain(message_decoder.decode(b"\x07")) == {"x": 7}
