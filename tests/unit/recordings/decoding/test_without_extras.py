"""A robot without the extra `reading` decodes all the same; what needs a library names the extra."""

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
    found = decoder_for("cdr", f"a/msg/Plain{ord(order)}", "ros2msg", TEXT)
    assert isinstance(found, Decoder)
    body = struct.pack(f"{order}2dI2hI2BxxI3BxI2s", 1.5, 2.5, 2, -1, 300, 2, 1, 0, 3, 7, 8, 9, 2, b"x\0")
    header = b"\0\1\0\0" if order == "<" else bytes(4)
    value = found.decode(header + body)
    assert to_plain(value) == {"a": [1.5, 2.5], "b": [-1, 300], "c": [True, False], "d": b"\7\x08\x09", "e": "x"}
    assert isinstance(value.a, array)  # type: ignore[attr-defined]  # the attribute exists at run time only
    assert value == found.decode(header + body)
    with pytest.raises(DecodeError):
        found.decode(header + body[:20])


@pytest.mark.parametrize(
    ("library", "ask"),
    [
        ("numpy", lambda found: image({})),
        ("numpy", lambda found: points({})),
        ("PIL", lambda found: image({"format": "png", "data": ""})),
        ("numpy", lambda found: to_arrow(found, [])),
        ("pyarrow", lambda found: to_arrow(found, [])),
        ("pandas", lambda found: to_pandas(found, [])),
    ],
)
def test_what_is_missing_is_named(library: str, ask: object, monkeypatch: pytest.MonkeyPatch) -> None:
    found = decoder_for("ros1", "a/B", "ros1msg", b"int32 x")
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ReadingExtraMissing, match=r"pip install 'open-kleinkram\[reading\]'"):
        ask(found)  # type: ignore[operator]  # one of the functions above


def test_protobuf_messages_stay_bytes_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    found = decoder_for("protobuf", "not asked before", "protobuf", b"")
    assert isinstance(found, Undecodable)
    assert "pip install 'open-kleinkram[reading]'" in found.reason


def test_importing_it_imports_none_of_them() -> None:
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


def test_a_table_of_arrow_does_not_import_pandas(tmp_path: Path) -> None:
    """pyarrow does, 60 MB and half a second, wherever it is given a list or an array of numpy."""
    generate_mcap(tmp_path / "drive.mcap", duration_s=6)
    command = [sys.executable, "-c", _TO_ARROW, str(tmp_path / "drive.mcap")]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "False\n"
