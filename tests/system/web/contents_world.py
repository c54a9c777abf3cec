"""Files of each kind that the file page shows, and hostile ones."""

import io
import json
import math
import struct
import wave
from pathlib import Path

import numpy as np
from PIL import Image

LINES = 70_000
VIDEO_SIZE = (64, 48)
VIDEO_FRAMES, FRAMES_PER_S = 20, 10
SOUND_S = 2
PICTURE_SIZE = (120, 80)
TABLE_ROWS = 20_000
WIDE_COLUMNS = 10_000
SCRIPT = "<script>globalThis.executed = true; alert(1)</script>"
SVG = f'<svg xmlns="http://www.w3.org/2000/svg" onload="globalThis.executed = true">{SCRIPT}</svg>\n'
_IMG = '<img src=x onerror="globalThis.executed = true">'
HTML = f'<!doctype html><body onload="globalThis.executed = true">{SCRIPT}{_IMG}\n'
STATE = {
    "id": 12345678901234567890,
    "joints": [1.5, -2.25, {"name": "knee", "limits": []}],
    "note": 'a: {"b"}, c',
    "on": True,
}


def line(number: int) -> str:
    """Return a line of the long text."""
    return f"{number:08d} [INFO] localisation: pose {number * 0.25:.2f} is plausible, residual below the bound\n"


def make_files(folder: Path) -> None:
    """Write all files."""
    _make_texts(folder)
    _make_tables(folder)
    _make_pictures(folder)
    (folder / "clip.webm").write_bytes(webm())
    with wave.open(str(folder / "tone.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", "not compressed"))
        tone = [int(8000 * math.sin(at / 8000 * 440 * math.tau)) for at in range(8000 * SOUND_S)]
        sound.writeframes(struct.pack(f"<{len(tone)}h", *tone))
    action = b"<< /OpenAction << /S /JavaScript /JS (app.alert(1)) >> >>"
    (folder / "paper.pdf").write_bytes(b"%PDF-1.7\n1 0 obj " + action + b" endobj\n")
    (folder / "cut.mp4").write_bytes(b"\0\0\0\x20ftypisom" + bytes(5000))


def _make_texts(folder: Path) -> None:
    (folder / "long.log").write_text("".join(map(line, range(LINES))))
    (folder / "notes.md").write_text("# Ride\n\n- **fine** <b>weather</b>\n")
    (folder / "config.yaml").write_text("camera:\n  rate_hz: 30\n  name: front\n")
    (folder / "state.json").write_text(json.dumps(STATE))
    latin = "Fahrt nach Zürich, Straße gesperrt\n".encode("latin-1")
    (folder / "latin.log").write_bytes(latin + b"bell \x07 \xe2\x80\xaeevil\n")
    (folder / "noise.txt").write_bytes(np.random.default_rng(1).integers(0, 256, 20_000, np.uint8).tobytes())
    (folder / "one-line.txt").write_text("x" * 1_000_000)
    (folder / "drawing.svg").write_text(SVG)
    (folder / "page.html").write_text(HTML)
    (folder / "page.png").write_text(HTML)


def _make_tables(folder: Path) -> None:
    seconds = np.arange(TABLE_ROWS) / 100
    rows = (f"{1.7e9 + at:.2f},{math.sin(at):.6f},{at * at:.3f},state {int(at) % 3}\n" for at in seconds.tolist())
    (folder / "table.csv").write_text("timestamp,sine,square,label\n" + "".join(rows))
    names = ",".join(f"column_{number}" for number in range(WIDE_COLUMNS))
    values = ",".join(map(str, range(WIDE_COLUMNS)))
    (folder / "wide.csv").write_text(f"{names}\n" + f"{values}\n" * 20)
    (folder / "formula.csv").write_text(f'name,value\n"=cmd|calc",1\n"{SCRIPT}",2\n')


def picture() -> Image.Image:
    """Return a picture that has a gradient to the right in red and one downwards in green."""
    width, height = PICTURE_SIZE
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[:, :, 0] = np.linspace(0, 255, width).astype(np.uint8)
    pixels[:, :, 1] = np.linspace(0, 255, height).astype(np.uint8)[:, None]
    return Image.fromarray(pixels)


def _make_pictures(folder: Path) -> None:
    for ending in ("png", "jpg", "webp", "gif", "bmp", "tiff"):
        picture().save(folder / f"photo.{ending}")
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 60_000, 60_000, 8, 6, 0, 0, 0)
    (folder / "bomb.png").write_bytes(header + bytes(4000))
    start = struct.pack(">8sI4sII", b"\x89PNG\r\n\x1a\n", 13, b"IHDR", 64, 64)
    (folder / "broken.png").write_bytes(start + b"\xff" * 2000)


def frame_colour(number: int) -> tuple[int, int, int]:
    """Return the colour of a frame of the video."""
    return (10 * number + 20, 120, 240 - 10 * number)


def webm() -> bytes:
    """Return a WebM of key frames: a lossy WebP contains one of VP8."""
    width, height = VIDEO_SIZE
    info = _element(0x2AD7B1, (1_000_000).to_bytes(3, "big")) + _element(
        0x4489, struct.pack(">d", 1000 * VIDEO_FRAMES / FRAMES_PER_S)
    )
    video = _element(0xB0, width.to_bytes(2, "big")) + _element(0xBA, height.to_bytes(2, "big"))
    track = b"".join(
        [
            _element(0xD7, b"\x01"),
            _element(0x73C5, b"\x01"),
            _element(0x83, b"\x01"),
            _element(0x86, b"V_VP8"),
            _element(0xE0, video),
        ]
    )
    head = _element(0x1549A966, info + _element(0x4D80, b"test") + _element(0x5741, b"test"))
    tracks = _element(0x1654AE6B, _element(0xAE, track))
    clusters = [_cluster(number) for number in range(VIDEO_FRAMES)]
    kind = b"".join(
        _element(number, value)
        for number, value in ((0x4286, b"\x01"), (0x42F7, b"\x01"), (0x42F2, b"\x04"), (0x42F3, b"\x08"))
    )
    kind += _element(0x4282, b"webm") + _element(0x4287, b"\x02") + _element(0x4285, b"\x02")
    return _element(0x1A45DFA3, kind) + _element(0x18538067, head + tracks + b"".join(clusters))


def _cluster(number: int) -> bytes:
    encoded = io.BytesIO()
    Image.new("RGB", VIDEO_SIZE, frame_colour(number)).save(encoded, "webp", quality=95)
    data = encoded.getvalue()
    at = data.index(b"VP8 ")
    frame = data[at + 8 : at + 8 + int.from_bytes(data[at + 4 : at + 8], "little")]
    time_ms = 1000 * number // FRAMES_PER_S
    return _element(
        0x1F43B675, _element(0xE7, time_ms.to_bytes(2, "big")) + _element(0xA3, b"\x81\x00\x00\x80" + frame)
    )


def _element(number: int, body: bytes) -> bytes:
    """Return an EBML element: its id, its length in eight bytes, and its content."""
    return number.to_bytes((number.bit_length() + 7) // 8, "big") + (1 << 56 | len(body)).to_bytes(8, "big") + body
