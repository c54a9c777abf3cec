"""Files of images have the pixels of the message, by Pillow and pixel by pixel."""

from __future__ import annotations

import io
import struct
import zlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.writing.image_files import ImageOptions, _chunk, image_file, why_no_images


def raw(encoding: str, array: Any) -> Any:
    height, width = array.shape[:2]
    sizes = {"height": height, "width": width, "step": 0, "is_bigendian": 0}
    return SimpleNamespace(encoding=encoding, data=array.tobytes(), header=None, **sizes)


def compressed(form: str, data: bytes) -> Any:
    return SimpleNamespace(format=form, data=data, header=None)


def stored(array: Any, form: str) -> bytes:
    out = io.BytesIO()
    Image.fromarray(array).save(out, form)
    return out.getvalue()


def pixels_of(data: bytes | memoryview) -> Any:
    with Image.open(io.BytesIO(data)) as opened:
        return np.asarray(opened)


def noise(*shape: int, dtype: str = "uint8") -> Any:
    return np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape).astype(dtype)


@pytest.mark.parametrize(("encoding", "channels"), [("mono8", 1), ("rgb8", 3), ("rgba8", 4), ("bayer_rggb8", 1)])
def test_raw_images_become_png(encoding: str, channels: int) -> None:
    array = noise(6, 5, channels)
    made = image_file(raw(encoding, array))
    assert (made.suffix, made.width, made.height) == ("png", 5, 6)
    assert np.array_equal(pixels_of(made.data), array[..., 0] if channels == 1 else array)


@pytest.mark.parametrize("encoding", ["bgr8", "8UC3"])
def test_files_have_colours_in_rgb_order(encoding: str) -> None:
    array = noise(2, 3, 3)
    assert np.array_equal(pixels_of(image_file(raw(encoding, array)).data), array[..., ::-1])


@pytest.mark.parametrize("encoding", ["mono16", "16UC1", "bayer_gbrg16"])
def test_16_bits_stay_16_bits(encoding: str) -> None:
    array = noise(4, 7, 1, dtype="uint16")
    made = image_file(raw(encoding, array))
    assert made.suffix == "png"
    assert np.array_equal(pixels_of(made.data), array[..., 0])


def test_16_bits_of_colour_are_in_the_file() -> None:
    """Pillow reads 8 of the 16 bits, so this test undoes the filter by itself."""
    array = noise(3, 4, 3, dtype="uint16")
    data = bytes(image_file(raw("rgb16", array)).data)
    assert np.array_equal(pixels_of(data), array >> 8)
    start = data.index(b"IDAT")
    size = struct.unpack(">I", data[start - 4 : start])[0]
    rows = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + size]), np.uint8).reshape(3, -1)
    assert (rows[:, 0] == 1).all()
    unfiltered = np.cumsum(rows[:, 1:].reshape(3, 4, 6), axis=1, dtype=np.uint8)
    assert np.array_equal(unfiltered.reshape(3, -1).view(">u2").reshape(3, 4, 3), array)


def test_float_depth_becomes_tiff() -> None:
    array = np.array([[1.5, np.nan], [np.inf, 0]], np.float32)[..., np.newaxis]
    made = image_file(raw("32FC1", array))
    assert made.suffix == "tiff"
    assert np.array_equal(pixels_of(made.data), array[..., 0], equal_nan=True)


@pytest.mark.parametrize(("form", "suffix"), [("JPEG", "jpg"), ("PNG", "png")])
def test_compressed_images_are_written_as_they_are(form: str, suffix: str) -> None:
    data = stored(noise(8, 9, 3), form)
    made = image_file(compressed(f"rgb8; {form.lower()} compressed bgr8", data))
    assert (bytes(made.data), made.suffix, made.width, made.height) == (data, suffix, 9, 8)


def test_the_suffix_is_that_of_the_bytes() -> None:
    assert image_file(compressed("jpeg", stored(noise(2, 2), "PNG"))).suffix == "png"


def test_compressed_depth_of_16_bits_is_its_png() -> None:
    array = noise(4, 5, dtype="uint16")
    made = image_file(compressed("16UC1; compressedDepth", bytes(12) + stored(array, "PNG")))
    assert made.suffix == "png"
    assert np.array_equal(pixels_of(made.data), array)


def test_other_compressions_become_png() -> None:
    out = io.BytesIO()
    Image.fromarray(noise(4, 4, 3)).save(out, "WEBP", lossless=True)
    made = image_file(compressed("webp", out.getvalue()))
    assert made.suffix == "png"
    assert np.array_equal(pixels_of(made.data), noise(4, 4, 3))


def test_raw_images_become_jpeg_where_chosen() -> None:
    assert image_file(raw("rgb8", noise(8, 8, 3)), as_jpeg=True).suffix == "jpg"
    assert image_file(raw("16UC1", noise(8, 8, 1, dtype="uint16")), as_jpeg=True).suffix == "png"
    assert image_file(raw("rgba8", noise(8, 8, 4)), as_jpeg=True).suffix == "png"


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (raw("8UC5", noise(2, 2, 5)), "pixels of 5 uint8 have no format of image files"),
        (raw("64FC1", np.zeros((1, 1, 1))), "pixels of 1 float64 have no format of image files"),
        (raw("16SC1", np.zeros((1, 1, 1), np.int16)), "pixels of 1 int16 have no format of image files"),
        (raw("mono8", np.zeros((0, 0, 1), np.uint8)), "the picture has no pixels"),
        (compressed("jpeg", b"\xff\xd8\xff but no more"), "its image cannot be read"),
        (compressed("h264", b"\0\0\0\1"), "its image cannot be read"),
        (SimpleNamespace(x=1), "it has no image"),
    ],
)
def test_what_cannot_be_written_is_named(value: Any, reason: str) -> None:
    with pytest.raises(DecodeError, match=reason):
        image_file(value)


def test_a_decompression_bomb_is_refused() -> None:
    """A PNG of a few bytes whose header promises 10 billion pixels; and a raw image that claims as many."""
    header = _chunk(b"IHDR", struct.pack(">IIBBBBB", 100_000, 100_000, 8, 0, 0, 0, 0))
    bomb = b"\x89PNG\r\n\x1a\n" + header + _chunk(b"IDAT", zlib.compress(bytes(1000))) + _chunk(b"IEND", b"")
    with pytest.raises(DecodeError, match="an image of more than 64000000 pixels"):
        image_file(compressed("png", bomb))
    huge = SimpleNamespace(encoding="mono8", data=b"", height=100_000, width=100_000, step=0, is_bigendian=0)
    with pytest.raises(DecodeError, match="pixels are more than"):
        image_file(huge)


@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.sampled_from([("mono8", 1, "u1"), ("rgb8", 3, "u1"), ("mono16", 1, "u2")]),
    st.integers(0, 2**32 - 1),
)
def test_png_is_lossless(height: int, width: int, kind: tuple[str, int, str], seed: int) -> None:
    encoding, channels, dtype = kind
    array = np.random.default_rng(seed).integers(0, 2**8 if dtype == "u1" else 2**16, (height, width, channels))
    array = array.astype(dtype)
    assert np.array_equal(pixels_of(image_file(raw(encoding, array)).data), array[..., 0] if channels == 1 else array)


@pytest.mark.parametrize("kind", ["sensor_msgs/msg/Image", "sensor_msgs/CompressedImage", "foxglove.RawImage"])
def test_types_with_images(kind: str) -> None:
    assert why_no_images(kind) is None


def test_types_without_images() -> None:
    assert why_no_images("foxglove.CompressedVideo") == "it is a video, not single images"
    assert why_no_images("sensor_msgs/msg/Imu") == "its messages, sensor_msgs/msg/Imu, are no images"


def test_selections_of_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        ImageOptions(every=0)
    with pytest.raises(ValueError, match="one of every and rate"):
        ImageOptions(every=2, rate_hz=1)
    for rate_hz in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="above 0"):
            ImageOptions(rate_hz=rate_hz)
