"""The built-in definitions are those of ROS 2, and used only where a recording has none."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, decoder_for, to_arrow, to_plain
from kleinkram.recordings.decoding.msg_definitions import known_definitions
from kleinkram.recordings.decoding.types import Array, Primitive, Struct, Type

RELEASES = [get_typestore(Stores[f"ROS2_{name}"]) for name in ("HUMBLE", "JAZZY", "IRON", "KILTED", "LYRICAL")]
TYPES = sorted({name for store in RELEASES for name in store.fielddefs})
LITTLE = b"\0\1\0\0"


def by_theirs(store: Any, name: str) -> list[tuple[str, Any]]:
    return [(field, _theirs(store, kind)) for field, kind in store.fielddefs[name][1]]


def _theirs(store: Any, kind: Any) -> Any:
    node, content = kind
    if node == Nodetype.BASE:
        return {"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(content[0], content[0])
    if node == Nodetype.NAME:
        return by_theirs(store, content)
    return [_theirs(store, content[0]), content[1] if node == Nodetype.ARRAY else None]


def by_ours(kind: Type) -> Any:
    if isinstance(kind, Primitive):
        return kind.name
    if isinstance(kind, Array):
        return [by_ours(kind.element), kind.length]
    assert isinstance(kind, Struct)
    fields = [(field.name, by_ours(field.type)) for field in kind.fields]
    return fields or [("structure_needs_at_least_one_member", "uint8")]


@pytest.mark.parametrize("name", TYPES)
def test_well_known_types_match_humble(name: str) -> None:
    store = next(store for store in RELEASES if name in store.fielddefs)
    ros_decoder = decoder_for("cdr", name, "", b"")
    assert isinstance(ros_decoder, Decoder), ros_decoder
    assert ros_decoder.struct is not None
    assert by_ours(ros_decoder.struct) == by_theirs(store, name)
    constants = {key: value for key, _, value in store.fielddefs[name][0]}
    assert dict(ros_decoder.struct.constants) == constants


def test_well_known_types_cover_common_interfaces() -> None:
    packages = {name.partition("/")[0].removesuffix("_msgs") for name in known_definitions()}
    package_names = (
        "sensor geometry nav visualization trajectory shape stereo action diagnostic lifecycle rosbag2_interfaces"
    )
    assert packages >= {*package_names.split()}


@pytest.mark.parametrize("store", RELEASES[1:], ids=["jazzy", "iron", "kilted", "lyrical"])
@pytest.mark.parametrize("name", ["sensor_msgs/msg/Range", "rosbag2_interfaces/msg/WriteSplitEvent"])
def test_messages_of_later_releases_are_decoded_by_their_definition(store: Any, name: str) -> None:
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](1, 2), "a")
    fields = {"header": header, "closed_file": "a", "opened_file": "bc", "node_name": "n"}
    names = [field for field, _ in store.fielddefs[name][1]]
    message = store.types[name](**{field: fields.get(field, 7) for field in names})
    data = bytes(store.serialize_cdr(message, name))
    ros_decoder = decoder_for("cdr", name, "", b"")
    assert isinstance(ros_decoder, Decoder)
    value = to_plain(ros_decoder.decode(data))
    assert {key: part for key, part in value.items() if key != "header"} == {
        key: fields.get(key, 7) for key in names if key != "header"
    }
    noticed: list[DecodeError] = []
    table = to_arrow(
        ros_decoder, [(time, time, data) for time in range(40)], notice=lambda _, error: noticed.append(error)
    )
    assert not noticed
    column = "max_range" if name.endswith("Range") else "opened_file"
    assert table[column].to_pylist() == [fields.get(column, 7)] * 40


def test_message_that_fits_no_release_is_an_error() -> None:
    ros_decoder = decoder_for("cdr", "sensor_msgs/msg/Range", "", b"")
    assert isinstance(ros_decoder, Decoder)
    with pytest.raises(DecodeError, match="left over"):
        ros_decoder.decode(LITTLE + bytes(100))


def test_definition_in_the_recording_wins() -> None:
    own = decoder_for("cdr", "std_msgs/msg/String", "ros2msg", b"int32 data")
    assert isinstance(own, Decoder)
    assert to_plain(own.decode(b"\0\1\0\0" + struct.pack("<i", 5))) == {"data": 5}
    unknown = decoder_for("cdr", "vicon_receiver/msg/Position", "", b"")
    assert isinstance(unknown, Undecodable)
    assert "has no definition" in unknown.reason


@pytest.mark.parametrize(("message", "schema"), [("cdr", "ros2msg"), ("ros1", "ros1msg"), ("cdr", "ros2idl")])
def test_empty_definition_counts_as_missing(message: str, schema: str) -> None:
    for text in (b"", b"\n \n"):
        ros_decoder = decoder_for(message, "vicon_receiver/msg/Position", schema, text)
        assert isinstance(ros_decoder, Undecodable)
        assert "definition" in ros_decoder.reason


def test_types_without_fields_have_an_empty_definition() -> None:
    ros2 = decoder_for("cdr", "std_msgs/msg/Empty", "ros2msg", b"")
    assert isinstance(ros2, Decoder)
    assert to_plain(ros2.decode(LITTLE + b"\0\0\0\0")) == {}
    with pytest.raises(DecodeError, match="left over"):
        ros2.decode(LITTLE + bytes(24))
    ros1 = decoder_for("ros1", "std_msgs/Empty", "ros1msg", b"")
    assert isinstance(ros1, Decoder)
    assert to_plain(ros1.decode(b"")) == {}


@pytest.mark.parametrize(
    ("message", "name"),
    [
        ("ros1", "std_srvs/TriggerRequest"),
        ("cdr", "std_srvs/srv/Trigger_Request"),
        ("ros1", "test_msgs/Empty"),
        ("cdr", "test_msgs/msg/Empty"),
    ],
)
def test_types_named_as_empty_have_no_fields(message: str, name: str) -> None:
    decoder = decoder_for(message, name, "ros1msg" if message == "ros1" else "ros2msg", b"")
    assert isinstance(decoder, Decoder)


def test_a_database_without_definitions_is_decoded(recordings_dir: Path) -> None:
    path = recordings_dir / "ros2-db3/chatter_no_metadata.db3"
    ros_decoder = decoder_for("cdr", "std_msgs/msg/String", "", b"")
    assert isinstance(ros_decoder, Decoder)
    with closing(sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)) as connection:
        texts = [
            to_plain(ros_decoder.decode(data))["data"] for (data,) in connection.execute("SELECT data FROM messages")
        ]
    assert len(texts) == 7
    assert all(text.startswith("Hello") for text in texts)
