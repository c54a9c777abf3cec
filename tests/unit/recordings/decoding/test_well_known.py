"""The definitions that we bring along are those of ROS 2 Humble, and only stand in where a recording has none."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, decoder_for, to_plain
from kleinkram.recordings.decoding.schema import Array, Primitive, Struct, Type
from kleinkram.recordings.decoding.well_known import NAMES

HUMBLE = get_typestore(Stores.ROS2_HUMBLE)


def by_theirs(name: str) -> list[tuple[str, Any]]:
    return [(field, _theirs(kind)) for field, kind in HUMBLE.get_msgdef(name).fields]


def _theirs(kind: Any) -> Any:
    node, content = kind
    if node == Nodetype.BASE:
        return {"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(content[0], content[0])
    if node == Nodetype.NAME:
        return by_theirs(content)
    return [_theirs(content[0]), content[1] if node == Nodetype.ARRAY else None]


def by_ours(kind: Type) -> Any:
    if isinstance(kind, Primitive):
        return kind.name
    if isinstance(kind, Array):
        return [by_ours(kind.element), kind.length]
    assert isinstance(kind, Struct)
    fields = [(field.name, by_ours(field.type)) for field in kind.fields]
    return fields or [("structure_needs_at_least_one_member", "uint8")]


@pytest.mark.parametrize("name", sorted(NAMES))
def test_it_is_the_definition_of_humble(name: str) -> None:
    full_name = name.replace("/", "/msg/")
    found = decoder_for("cdr", full_name, "", b"")
    assert isinstance(found, Decoder)
    assert found.struct is not None
    assert by_ours(found.struct) == by_theirs(full_name)


def test_a_recordings_own_definition_goes_first() -> None:
    own = decoder_for("cdr", "std_msgs/msg/String", "ros2msg", b"int32 data")
    assert isinstance(own, Decoder)
    assert to_plain(own.decode(b"\0\1\0\0" + struct.pack("<i", 5))) == {"data": 5}
    unknown = decoder_for("cdr", "vicon_receiver/msg/Position", "", b"")
    assert isinstance(unknown, Undecodable)
    assert "holds no definition" in unknown.reason


def test_an_empty_definition_explains_only_empty_messages() -> None:
    found = decoder_for("cdr", "vicon_receiver/msg/Position", "ros2msg", b"")
    assert isinstance(found, Decoder)
    assert to_plain(found.decode(b"\0\1\0\0\0\0\0\0")) == {}
    with pytest.raises(DecodeError, match="no such message"):
        found.decode(b"\0\1\0\0" + bytes(24))


def test_a_database_without_definitions_is_decoded(recordings_dir: Path) -> None:
    path = recordings_dir / "ros2-db3/chatter_no_metadata.db3"
    found = decoder_for("cdr", "std_msgs/msg/String", "", b"")
    assert isinstance(found, Decoder)
    with closing(sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)) as connection:
        texts = [to_plain(found.decode(data))["data"] for (data,) in connection.execute("SELECT data FROM messages")]
    assert len(texts) == 7
    assert all(text.startswith("Hello") for text in texts)
