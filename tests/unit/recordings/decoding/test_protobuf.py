"""Protobuf messages as plain values and as tables."""

from __future__ import annotations

import json
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from kleinkram.recordings.decoding import Decoder, decoder_for, to_arrow, to_pandas, to_plain

F = descriptor_pb2.FieldDescriptorProto


def described(comment: str = "") -> descriptor_pb2.FileDescriptorSet:
    """A proto2 file with repeated fields of all kinds, a map, a oneof, an optional field, a group and an extension."""
    file = descriptor_pb2.FileDescriptorProto(name="a.proto", package="p", syntax="proto2")
    file.dependency.append("google/protobuf/timestamp.proto")
    if comment:
        file.source_code_info.location.add(leading_comments=comment)
    kind = file.enum_type.add(name="Kind")
    kind.value.add(name="NONE", number=0)
    kind.value.add(name="SOME", number=1)
    part = file.message_type.add(name="Part")
    part.field.add(name="x", number=1, type=F.TYPE_DOUBLE, label=1)
    part.field.add(name="parts", number=2, type=F.TYPE_MESSAGE, type_name=".p.Part", label=3)
    part.field.add(name="tolist", number=3, type=F.TYPE_INT32, label=1)  # the name of a method of arrays
    top = file.message_type.add(name="M")
    top.field.add(name="stamp", number=1, type=F.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp", label=1)
    top.field.add(name="nums", number=2, type=F.TYPE_DOUBLE, label=3)
    top.field.add(name="parts", number=3, type=F.TYPE_MESSAGE, type_name=".p.Part", label=3)
    top.field.add(name="kinds", number=4, type=F.TYPE_ENUM, type_name=".p.Kind", label=3)
    top.field.add(name="names", number=5, type=F.TYPE_STRING, label=3)
    top.field.add(name="blobs", number=6, type=F.TYPE_BYTES, label=3)
    top.field.add(name="counts", number=7, type=F.TYPE_MESSAGE, type_name=".p.M.CountsEntry", label=3)
    top.field.add(name="flag", number=8, type=F.TYPE_BOOL, label=1)
    top.oneof_decl.add(name="choice")
    top.field.add(name="left", number=9, type=F.TYPE_INT64, label=1, oneof_index=0)
    top.field.add(name="right", number=10, type=F.TYPE_STRING, label=1, oneof_index=0)
    top.field.add(name="group", number=11, type=F.TYPE_GROUP, type_name=".p.M.Group", label=3)
    entry = top.nested_type.add(name="CountsEntry")
    entry.options.map_entry = True
    entry.field.add(name="key", number=1, type=F.TYPE_STRING, label=1)
    entry.field.add(name="value", number=2, type=F.TYPE_MESSAGE, type_name=".p.Part", label=1)
    top.nested_type.add(name="Group").field.add(name="y", number=1, type=F.TYPE_INT32, label=1)
    top.extension_range.add(start=100, end=200)
    file.extension.add(name="more", number=100, type=F.TYPE_INT32, label=3, extendee=".p.M")
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    return descriptor_pb2.FileDescriptorSet(file=[stamp, file])


def sample() -> bytes:
    pool = descriptor_pool.DescriptorPool()
    for file in described().file:
        pool.Add(file)
    message: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName("p.M"))()
    message.stamp.seconds = 5
    message.nums.extend([1, 2.5])
    message.parts.add(x=1.5, tolist=4).parts.add(x=2.5)
    message.kinds.extend([1, 0])
    message.names.append("a")
    message.blobs.append(b"\xff")
    message.counts["k"].x = 3.5
    message.right = "r"
    message.group.add(y=7)
    extension = pool.FindExtensionByName("p.more")
    message.Extensions[extension].append(9)
    return bytes(message.SerializeToString())


def decoder(comment: str = "") -> Decoder:
    message_decoder = decoder_for("protobuf", "p.M", "protobuf", described(comment).SerializeToString())
    assert isinstance(message_decoder, Decoder), message_decoder
    return message_decoder


EXPECTED = {
    "stamp": {"seconds": 5, "nanos": 0},
    "nums": [1.0, 2.5],
    "parts": [{"x": 1.5, "parts": [{"x": 2.5, "parts": []}], "tolist": 4}],
    "kinds": [1, 0],
    "names": ["a"],
    "blobs": [b"\xff"],
    "counts": {"k": {"x": 3.5, "parts": []}},
    "right": "r",
    "group": [{"y": 7}],
    "p.more": [9],
}


def test_fields_of_all_kinds_are_plain_values() -> None:
    plain = to_plain(decoder().decode(sample()))
    assert plain == EXPECTED
    assert type(plain["nums"]) is type(plain["parts"]) is list
    del plain["blobs"]
    assert json.loads(json.dumps(plain)) == plain


def test_fields_of_all_kinds_are_columns() -> None:
    messages = [(n, n, sample() if n else b"") for n in range(3)]
    table = to_arrow(decoder(), messages)
    row = table.to_pylist()[2]
    assert row["nums"] == [1.0, 2.5]
    assert row["parts"][0]["x"] == 1.5
    assert row["counts"] == [{"key": "k", "value": {"x": 3.5, "parts": []}}]
    assert (row["kinds"], row["right"], row["group"], row["blobs"]) == ([1, 0], "r", [{"y": 7}], [b"\xff"])
    assert (row["stamp.seconds"], row["p.more"]) == (5, [9])
    assert table["nums"].to_pylist()[0] == []
    assert [*to_pandas(decoder(), messages)["nums"][1]] == [1.0, 2.5]


def test_comments_do_not_change_a_layout() -> None:
    assert decoder().layout == decoder("a comment").layout


@pytest.mark.parametrize("schema", [b"", b"\n\0"])
def test_an_empty_descriptor_set_is_undecodable(schema: bytes) -> None:
    assert not isinstance(decoder_for("protobuf", "p.M", "protobuf", schema), Decoder)
