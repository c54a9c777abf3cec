"""Recordings of Stereolabs cameras (SVO2): an MCAP whose topics carry the camera's serial number.

Source: observed; topics `svo_header`, `svo_footer`, `Camera_SN<number>/side_by_side`, `.../sensors`; the library in
the MCAP header is "libmcap stereolabs".
"""

from __future__ import annotations

import re
from dataclasses import replace

from kleinkram.recordings.formats.base import Format
from kleinkram.recordings.formats.mcap.format import scan_mcap, summarise_mcap
from kleinkram.recordings.formats.mcap.records import MAGIC
from kleinkram.recordings.model import Fact, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import Source

_LIBRARY_WORD = b"stereolabs"
_MCAP_HEADER_BYTES = 64
_CAMERA = re.compile(r"Camera_SN(?P<serial>\d{1,20})/(?P<what>\w+)")


def as_svo2(summary: RecordingSummary) -> RecordingSummary:
    """Return the summary of an SVO2's MCAP as that of an SVO2: with its cameras and their frames as facts."""
    facts: list[Fact] = []
    for topic in summary.topics:
        match = _CAMERA.fullmatch(topic.name)
        if match is not None and match["what"] == "side_by_side":
            facts.append(Fact("camera_serial", match["serial"]))
            if topic.count is not None:
                facts.append(Fact("frames", topic.count))
    return replace(summary, format=RecordingFormat.svo2, facts=(*facts, *summary.facts))


def _summarise(source: Source, *, most_bytes: int) -> RecordingSummary:
    return as_svo2(summarise_mcap(source, most_bytes=most_bytes))


SVO2 = Format(
    RecordingFormat.svo2,
    lambda head: head.data.startswith(MAGIC) and _LIBRARY_WORD in head.data[len(MAGIC) :][:_MCAP_HEADER_BYTES],
    "a recording of a ZED camera (SVO2)",
    extensions=(".svo2", ".mcap"),
    scan=lambda reader: as_svo2(scan_mcap(reader)),
    summarise=_summarise,
    refusal="it is a SVO2 of a ZED camera, and reading that format is not supported",
)
