"""Recordings of Stereolabs cameras (SVO2): an MCAP whose topics carry the camera's serial number.

Source: observed; topics `svo_header`, `svo_footer`, `Camera_SN<number>/side_by_side`, `.../sensors`; the library in
the MCAP header is "libmcap stereolabs".
"""

from __future__ import annotations

import re
from dataclasses import replace

from kleinkram.recordings.model import Fact, RecordingFormat, RecordingSummary

LIBRARY_WORD = b"stereolabs"
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
