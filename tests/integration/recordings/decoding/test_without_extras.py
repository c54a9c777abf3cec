"""Decoding without the extra `reading`; features that need a library name the extra."""

from __future__ import annotations

import struct
import subprocess
import sys
from array import array
from pathlib import Path

import pytest

from kleinkram.recordings.decoding import (
    DecodeError,
    Decoder,
    ReadingExtraMissing,
    Undecodable,
    decoder_for,
    image,
    points,
    to_arrow,
    to_pandas,
    to_plain,
)
from kleinkram.recordings.sample import generate_mcap

TEXT = b"float64[2] a\nint16[] b\nbool[] c\nuint8[] d\nstring e # without numpy"


@pytest.fixture
def without_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numpy", None)


@pytest.mark.usefixtures("without_numpy")
@pytest.mark.parametrize("order", ["<", ">"])
def test_arrays_without_numpy(order: str) -> None:
    message_decoder = decoder_for("cdr", f"a/msg/Plain{ord(order)}", "ros2msg", TEXT)
    assert isinstance(message_decoder, Decoder)
    body = struct.pack(f"{order}2dI2hI2BxxI3BxI2s", 1.5, 2.5, 2, -1, 300, 2, 1, 0, 3, 7, 8, 9, 2, b"x\0")
    header = b"\0\1\0\0" if order == "<" else bytes(4)
    value = message_decoder.decode(header + body)
    assert to_plain(value) == {"a": [1.5, 2.5], "b": [-1, 300], "c": [True, False], "d": b"\7\x08\x09", "e": "x"}
    assert isinstance(value.a, array)  # type: ignore[attr-defined]  # the attribute exists at run time only
    assert value == message_decoder.decode(header + body)
    with pytest.raises(DecodeError):
        message_decoder.decode(header + body[:20])


@pytest.mark.parametrize(
    ("library", "ask"),
    [
        ("numpy", lambda message_decoder: image({})),
        ("numpy", lambda message_decoder: points({})),
        ("PIL", lambda message_decoder: image({"format": "png", "data": ""})),
        ("numpy", lambda message_decoder: to_arrow(message_decoder, [])),
        ("pyarrow", lambda message_decoder: to_arrow(message_decoder, [])),
        ("pandas", lambda message_decoder: to_pandas(message_decoder, [])),
    ],
)
def test_missing_library_is_named(library: str, ask: object, monkeypatch: pytest.MonkeyPatch) -> None:
    message_decoder = decoder_for("ros1", "a/B", "ros1msg", b"int32 x")
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ReadingExtraMissing, match=r"pip install 'open-kleinkram\[reading\]'"):
        ask(message_decoder)  # type: ignore[operator]  # one of the functions above


def test_protobuf_messages_stay_bytes_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    message_decoder = decoder_for("protobuf", "not asked before", "protobuf", b"")
    assert isinstance(message_decoder, Undecodable)
    assert "pip install 'open-kleinkram[reading]'" in message_decoder.reason


def test_importing_decoding_imports_no_optional_library() -> None:
    code = "import sys, kleinkram.recordings.decoding; print([n for n in sys.argv[1:] if n in sys.modules])"
    command = [sys.executable, "-c", code, "numpy", "pyarrow", "pandas", "PIL", "google.protobuf"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "[]\n"


_TO_ARROW = """
import sys
from kleinkram.recordings import Recording
with Recording.open(sys.argv[1]) as recording:
    for topic in ("/imu/data", "/odom", "/gps/fix"):
        assert recording.to_arrow(topic).num_rows > 20
print("pandas" in sys.modules)
"""


def test_to_arrow_does_not_import_pandas(tmp_path: Path) -> None:
    """pyarrow does, 60 MB and half a second, wherever it is given a list or an array of numpy."""
    generate_mcap(tmp_path / "drive.mcap", duration_s=6)
    command = [sys.executable, "-c", _TO_ARROW, str(tmp_path / "drive.mcap")]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "False\n"
