"""From what a person has (a file, a folder, sources) to the opened files of one recording."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Protocol, runtime_checkable

from kleinkram.recordings.grouping import METADATA_NAME, group
from kleinkram.recordings.model import RecordingFormat
from kleinkram.recordings.reading.errors import NotARecording, SeveralRecordings
from kleinkram.recordings.reading.member import Member, open_mcap
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.rosbag2.metadata import MAX_TEXT, Rosbag2Metadata, parse_rosbag2_metadata
from kleinkram.recordings.sniffing import sniff
from kleinkram.recordings.sources import FileSource, Source


@runtime_checkable
class HasSources(Protocol):
    """Something that stands for the files of one recording, such as a file on a server."""

    def sources(self) -> Sequence[Source]:
        """Return the files in the order of recording, a metadata.yaml among them where there is one."""


Openable = str | os.PathLike[str] | Source | HasSources | Sequence[Source]


@dataclass(frozen=True)
class Opened:
    """The files of a recording. `stack`: what is to be closed with them."""

    name: str
    members: tuple[Member, ...]
    stack: ExitStack


def open_members(what: Openable, noticed: Noticed) -> Opened:
    """Open the files of a recording.

    Raises:
        FileNotFoundError: there is no such file or folder.
        NotARecording: there are no messages in it that we read.
        SeveralRecordings: the folder holds several.
        SourceError: the bytes cannot be read.
    """
    with ExitStack() as stack:
        name, sources = _sources_of(what, stack)
        metadata = _metadata_of(sources, noticed)
        data = [source for source in sources if PurePosixPath(source.name).name != METADATA_NAME]
        if not data:
            raise NotARecording(name, "there is no recording in it")
        members = tuple(_open_member(source, metadata, noticed, stack) for source in data)
        return Opened(name, members, stack.pop_all())


def _sources_of(what: Openable, stack: ExitStack) -> tuple[str, Sequence[Source]]:
    if isinstance(what, str | os.PathLike):
        path = Path(what)
        return str(path), [stack.enter_context(FileSource(member)) for member in _paths_of(path)]
    if isinstance(what, HasSources):
        sources = [*what.sources()]
    elif isinstance(what, Sequence):
        sources = [*what]
    else:
        sources = [what]
    return sources[0].name if sources else "nothing", sources


def _paths_of(path: Path) -> list[Path]:
    if path.is_file() and path.name == METADATA_NAME:
        path = path.parent
    if not path.is_dir():
        if not path.exists():
            raise FileNotFoundError(f"{path}: there is no such file or folder")
        return [path]
    names = [found.relative_to(path).as_posix() for found in path.rglob("*") if found.is_file()]
    groups = group(names)
    if not groups:
        raise NotARecording(str(path), "there is no recording in it")
    if len(groups) > 1:
        raise SeveralRecordings(str(path), [str(path / found.name) for found in groups])
    (found,) = groups
    metadata = [found.metadata_path] if found.metadata_path else []
    return [path / name for name in [*metadata, *found.members]]


def _metadata_of(sources: Iterable[Source], noticed: Noticed) -> Rosbag2Metadata | None:
    """Read the metadata.yaml among the sources, and compare it with what is there."""
    names = [PurePosixPath(source.name).name for source in sources]
    for source, name in zip(sources, names, strict=True):
        if name != METADATA_NAME:
            continue
        text = source.read(0, min(source.size_bytes, MAX_TEXT)).decode("utf-8", "replace")
        metadata = parse_rosbag2_metadata(text) if source.size_bytes <= MAX_TEXT else None
        if metadata is None:
            noticed.add("metadata-damaged", source.name, "it is not the metadata of a rosbag2 recording")
            return None
        _name_missing(metadata, set(names), noticed)
        return metadata
    return None


def _name_missing(metadata: Rosbag2Metadata, names: set[str], noticed: Noticed) -> None:
    claimed = [PurePosixPath(path).name for path in metadata.files]
    for missing in claimed:
        if missing not in names:
            noticed.add("member-missing", missing, "metadata.yaml names it, but it is not there")
    for surplus in sorted(names - {METADATA_NAME, *claimed}):
        noticed.add("member-surplus", surplus, "it is there, but metadata.yaml does not name it")


def _open_member(source: Source, metadata: Rosbag2Metadata | None, noticed: Noticed, stack: ExitStack) -> Member:
    by_message = metadata is not None and metadata.compression_mode == "message"
    compression = metadata.compression if metadata is not None and by_message else ""
    kind = sniff(source)
    if kind is RecordingFormat.mcap:
        return open_mcap(source, noticed, message_compression=compression)
    raise NotARecording(source.name, f"it is {kind.value}, not a recording whose messages are read")
