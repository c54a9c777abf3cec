"""The zstd of the server makes the frames of the browser's: slices have the same bytes (docs/slices.md).

`web/src/recordings/slices/make_slice.test.ts` compares the browser's module with the same file. If this fails after an
upgrade, upgrade the other one to the same libzstd too, and then replace the values.
"""

import hashlib
import json
from pathlib import Path

import zstandard

from kleinkram.recordings.writing.mcap import McapOptions, mcap_compressor

_ROOT = Path(__file__).parents[3]
_EXPECTED = json.loads((_ROOT / "tests/recording_files/zstd_frame.json").read_text())


def test_a_frame_is_that_of_the_browser() -> None:
    raw = bytes((number * number % 251) ^ (number >> 7) & 255 for number in range(300_000))
    assert ".".join(map(str, zstandard.ZSTD_VERSION)) == _EXPECTED["libzstd"]
    assert hashlib.sha256(mcap_compressor(McapOptions())(raw)).hexdigest() == _EXPECTED["sha256"]


def test_the_documentation_names_the_version() -> None:
    assert f"({_EXPECTED['libzstd']})" in (_ROOT / "docs/slices.md").read_text()
