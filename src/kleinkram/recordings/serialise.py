"""Summaries and metadata.yaml as plain JSON values and back. The shape is stable: fields are added, never renamed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from kleinkram.recordings.model import (
    Content,
    Density,
    Depth,
    Fact,
    Lost,
    Problem,
    RecordingFormat,
    RecordingSummary,
    TopicSummary,
)
from kleinkram.recordings.rosbag2.metadata import Rosbag2Metadata, StatedFile, StatedTopic


def to_dict(summary: RecordingSummary) -> dict[str, Any]:
    """Return a summary as what `json.dumps` takes; enums as their values, times as integers."""
    plain = asdict(summary)
    plain["format"] = summary.format.value
    plain["content"] = summary.content.value
    plain["depth"] = summary.depth.value
    for name in ("compression", "topics", "problems", "facts"):
        plain[name] = list(plain[name])
    return plain


def from_dict(plain: Mapping[str, Any]) -> RecordingSummary:
    """Return the summary that `to_dict` was given.

    Raises:
        KeyError, TypeError, ValueError: it is not one.
    """
    values = dict(plain)
    values["format"] = RecordingFormat(values["format"])
    values["content"] = Content(values["content"])
    values["compression"] = tuple(values["compression"])
    values["topics"] = tuple(_topic(topic) for topic in values["topics"])
    values["problems"] = tuple(Problem(**problem) for problem in values["problems"])
    values["depth"] = Depth(values["depth"])
    values["lost"] = Lost(**values["lost"]) if values["lost"] is not None else None
    values["facts"] = tuple(Fact(**fact) for fact in values["facts"])
    return RecordingSummary(**values)


def _topic(plain: Mapping[str, Any]) -> TopicSummary:
    density = plain["density"]
    counted = Density(**{**density, "counts": tuple(density["counts"])}) if density is not None else None
    return TopicSummary(**{**plain, "density": counted})


def metadata_from_dict(plain: Mapping[str, Any]) -> Rosbag2Metadata:
    """Return what `dataclasses.asdict` was given, after a way through JSON.

    Raises:
        KeyError, TypeError: it is none.
    """
    values = dict(plain)
    values["files"] = tuple(values["files"])
    values["topics"] = tuple(StatedTopic(**topic) for topic in values["topics"])
    values["file_entries"] = tuple(StatedFile(**entry) for entry in values["file_entries"])
    return Rosbag2Metadata(**values)
