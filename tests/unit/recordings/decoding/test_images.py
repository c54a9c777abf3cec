"""Images: every encoding pixel by pixel; contradictory headers are named."""

from __future__ import annotations

import base64
import io
import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from kleinkram.recordings.decoding import DecodeError, image


def raw(encoding: str, data: bytes, *, height: int = 1, width: int = 2, step: int = 0, big: int = 0) -> Any:
    sizes = {"height": height, "width": width, "step": step, "is_bigendian": big}
    return SimpleNamespace(encoding=encoding, data=data, header=None, **sizes)


def compressed(form: str, data: bytes) -> Any:
    return SimpleNamespace(format=form, data=data, header=None)


def stored(array: Any, form: str, **options: Any) -> bytes:
    out = io.BytesIO()
    Image.fromarray(array).save(out, form, **options)
    return out.getvalue()


@pytest.mark.parametrize(
    ("encoding", "data", "dtype", "expected"),
    [
        ("mono8", bytes([1, 2]), "uint8", [[[1], [2]]]),
        ("rgb8", bytes([1, 2, 3, 4, 5, 6]), "uint8", [[[1, 2, 3], [4, 5, 6]]]),
        ("bgr8", bytes([1, 2, 3, 4, 5, 6]), "uint8", [[[3, 2, 1], [6, 5, 4]]]),
        ("rgba8", bytes(range(8)), "uint8", [[[0, 1, 2, 3], [4, 5, 6, 7]]]),
        ("bgra8", bytes(range(8)), "uint8", [[[2, 1, 0, 3], [6, 5, 4, 7]]]),
        ("mono16", struct.pack("<2H", 1, 65535), "uint16", [[[1], [65535]]]),
        ("16UC1", struct.pack("<2H", 1, 65535), "uint16", [[[1], [65535]]]),
        ("16SC1", struct.pack("<2h", 1, -1), "int16", [[[1], [-1]]]),
        ("32FC1", struct.pack("<2f", 1.5, -1), "float32", [[[1.5], [-1]]]),
        ("8UC3", bytes([1, 2, 3, 4, 5, 6]), "uint8", [[[1, 2, 3], [4, 5, 6]]]),
        ("8UC", bytes([1, 2]), "uint8", [[[1], [2]]]),
        ("bgr16", struct.pack("<6H", 1, 2, 3, 4, 5, 6), "uint16", [[[3, 2, 1], [6, 5, 4]]]),
        ("bayer_rggb8", bytes([1, 2]), "uint8", [[[1], [2]]]),
        ("bayer_gbrg16", struct.pack("<2H", 1, 300), "uint16", [[[1], [300]]]),
        ("yuv422", bytes([128, 16, 128, 235]), "uint8", [[[0, 0, 0], [255, 255, 255]]]),
        ("uyvy", bytes([90, 81, 240, 81]), "uint8", [[[255, 0, 0], [255, 0, 0]]]),
        ("yuv422_yuy2", bytes([81, 90, 81, 240]), "uint8", [[[255, 0, 0], [255, 0, 0]]]),
        ("yuyv", bytes([16, 128, 235, 128]), "uint8", [[[0, 0, 0], [255, 255, 255]]]),
    ],
)
def test_encodings(encoding: str, data: bytes, dtype: str, expected: list[Any]) -> None:
    pixels = image(raw(encoding, data))
    assert pixels.dtype == np.dtype(dtype)
    difference = np.abs(pixels.astype(float) - np.array(expected, float))
    assert difference.max() <= (2 if "y" in encoding and "bayer" not in encoding else 0)


@pytest.mark.parametrize(("encoding", "colour"), [("nv12", [90, 240]), ("nv21", [240, 90])])
def test_planar_yuv(encoding: str, colour: list[int]) -> None:
    pixels = image(raw(encoding, bytes([81] * 4 + colour), height=2, width=2))
    assert pixels.shape == (2, 2, 3)
    assert np.abs(pixels.astype(int) - [255, 0, 0]).max() <= 2


def test_rows_may_be_padded_and_the_last_need_not_be() -> None:
    pixels = image(raw("mono8", bytes([1, 2, 0, 0, 3, 4]), height=2, step=4))
    assert pixels.tolist() == [[[1], [2]], [[3], [4]]]


def test_big_endian_pixels_are_byte_swapped() -> None:
    pixels = image(raw("mono16", struct.pack(">2H", 1, 258), big=1))
    assert pixels.tolist() == [[[1], [258]]]
    assert pixels.dtype.isnative


def test_an_empty_picture() -> None:
    assert image(raw("rgb8", b"", height=0, width=0)).shape == (0, 0, 3)
    assert image(raw("rgb8", np.empty(0, np.uint8), height=0, width=5)).shape == (0, 5, 3)  # type: ignore[arg-type]  # as decoded


@pytest.mark.parametrize(
    ("value", "why"),
    [
        (raw("rgb8", bytes(5)), "do not fit"),
        (raw("rgb8", bytes(100), step=5), "do not fit"),
        (raw("mono8", b"", height=2**31, width=2**31), "more than"),
        (raw("made_up", bytes(5)), "'made_up' is not supported"),
        (raw("16FC1", bytes(5)), "'16FC1' is not supported"),
        (raw("yuyv", bytes(6), width=3), "must be even"),
        (raw("nv12", bytes(8), height=3), "must be even"),
        (raw("mono8", b"12", width=-1), "not a size"),
        (raw("mono8", "not base64!"), "base64"),  # type: ignore[arg-type]  # as JSON has it
        (raw("mono8", 3.5), "not bytes"),  # type: ignore[arg-type]  # as JSON has it
        (compressed("jpeg", b""), "cannot be read"),
        (compressed("png", b"\x89PNG\r\n\x1a\n" + bytes(30)), "cannot be read"),
        (compressed("16UC1; compressedDepth rvl", bytes(40)), "RVL"),
        (compressed("16UC1; compressedDepth png", bytes(4)), "no header"),
        (SimpleNamespace(x=1), "no image"),
    ],
)
def test_values_that_are_not_images_are_refused(value: object, why: str) -> None:
    with pytest.raises(DecodeError, match=why):
        image(value)


def test_compressed_pictures() -> None:
    colours = np.zeros((4, 6, 3), np.uint8)
    colours[:, :3] = (255, 0, 0)
    assert image(compressed("png", stored(colours, "PNG"))).tolist() == colours.tolist()
    jpeg = image(
        compressed("bgr8; jpeg compressed bgr8", stored(colours.repeat(8, 0).repeat(8, 1), "JPEG", quality=95))
    )
    assert jpeg.shape == (32, 48, 3)
    assert np.abs(jpeg[0, 0].astype(int) - [255, 0, 0]).max() < 8
    grey = np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert image(compressed("png", stored(grey, "PNG"))).tolist() == grey[..., None].tolist()
    deep = np.array([[0, 1], [40_000, 65_535]], np.uint16)
    pixels = image(compressed("mono16; png compressed", stored(deep, "PNG")))
    assert pixels.dtype == np.uint16
    assert pixels[..., 0].tolist() == deep.tolist()
    assert image({"format": "png", "data": base64.b64encode(stored(grey, "PNG")).decode()}).shape == (2, 3, 1)


def test_compressed_depth() -> None:
    depth = np.array([[0, 1000], [2000, 3]], np.uint16)
    png = struct.pack("<iff", 0, 100.0, -2.0) + stored(depth, "PNG")
    assert image(compressed("16UC1; compressedDepth png", png))[..., 0].tolist() == depth.tolist()
    metres = image(compressed("32FC1; compressedDepth png", png))[..., 0]
    assert metres.dtype == np.float32
    assert np.isnan(metres[0, 0])
    assert metres[0, 1] == pytest.approx(100 / 1002)


def test_decompression_bomb_is_refused() -> None:
    header = struct.pack(">I4sIIBBBBB", 13, b"IHDR", 12_000, 12_000, 8, 2, 0, 0, 0) + bytes(4)
    with pytest.raises(DecodeError):
        image(compressed("png", b"\x89PNG\r\n\x1a\n" + header))
    flat = stored(np.zeros((9000, 9000), np.uint8), "PNG", compress_level=1)
    with pytest.raises(DecodeError, match="more than"):
        image(compressed("png", flat))


PNG = stored(np.arange(300, dtype=np.uint8).reshape(10, 10, 3), "PNG")
JPEG = stored(np.arange(300, dtype=np.uint8).reshape(10, 10, 3), "JPEG")


@settings(max_examples=150, deadline=None)
@given(which=st.sampled_from([PNG, JPEG]), at=st.integers(0, 1000), byte=st.integers(0, 255), cut=st.integers(0, 1000))
def test_broken_pictures(which: bytes, at: int, byte: int, cut: int) -> None:
    data = bytearray(which)
    data[at % len(data)] = byte
    try:
        pixels = image(compressed("", bytes(data[: max(1, cut % len(data))] if cut % 2 else data)))
    except DecodeError:
        return
    assert pixels.ndim == 3
