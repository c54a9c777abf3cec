"""The keys of the query language: what each says of a filter, and what may stand behind it."""

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from kleinkram.contract.amounts import read_month
from kleinkram.contract.files import BlobState, ContentState

META = "meta."
_SAME = (":", "=")
_COMPARED = (">", ">=", "<", "<=", *_SAME)


@dataclass(frozen=True)
class Key:
    """A key. `field` is that of `FileFilter`; `id_field` takes its place where the value is an id.

    `several_field` holds the names, globs and ids of a key that is said several times.
    `is_list`: it may be said several times, and any of these is enough. `check` returns a value as it is kept.
    """

    name: str
    field: str
    example: str
    operators: tuple[str, ...] = _SAME
    is_list: bool = False
    id_field: str | None = None
    several_field: str | None = None
    only_id: bool = False
    check: Callable[[str], str] = str


def one_of(kind: type[BlobState] | type[ContentState]) -> Callable[[str], str]:
    """Return what lets the words of an enumeration through, in any case."""
    words = [each.value for each in kind]

    def check(value: str) -> str:
        if value.lower() not in words:
            raise ValueError(f"it is one of {', '.join(words)}")
        return value.lower()

    return check


_KEYS = (
    Key("project", "project", "project:NAME", id_field="project_id", several_field="projects"),
    Key("mission", "mission", "mission:NAME", id_field="mission_id", several_field="missions"),
    Key("recording", "recording_id", "recording:ID", id_field="recording_id", only_id=True),
    Key("path", "path", "path:*.mcap", is_list=True),
    Key("topic", "topic", "topic:/imu/*", is_list=True),
    Key("type", "message_type", "type:*/Image", is_list=True),
    Key("label", "label", "label:LABEL", is_list=True),
    Key("format", "format", "format:mcap", is_list=True),
    Key("content", "content", "content:broken", is_list=True, check=one_of(ContentState)),
    Key("problem", "problem", "problem:long-gap", is_list=True),
    Key("state", "state", "state:verified", is_list=True, check=one_of(BlobState)),
    Key("month", "month", "month:2026-05", is_list=True, check=read_month),
    Key("size", "size_bytes", "size>1GB", _COMPARED),
    Key("duration", "duration_ns", "duration>10m", _COMPARED),
    Key("after", "recorded_after", "after:2026-05-01"),
    Key("before", "recorded_before", "before:2026-05-01"),
)
KEYS: Mapping[str, Key] = {key.name: key for key in _KEYS}


def is_glob(value: str) -> bool:
    """Say whether a value may stand for several."""
    return "*" in value or "?" in value


def possible(given: str) -> str:
    """Return what is said of a key that there is none of: what may have been meant, and what there is."""
    close = difflib.get_close_matches(given.lower()[:40], KEYS, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"there is no key {given!r}; {hint}There are {', '.join(KEYS)} and {META}FIELD"
