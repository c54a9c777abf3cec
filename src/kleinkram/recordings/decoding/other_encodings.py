"""Messages that are JSON or protobuf."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from kleinkram.recordings.decoding.errors import DecodeError, ReadingExtraMissing, SchemaError
from kleinkram.recordings.decoding.limits import MAX_JSON_DEPTH, MAX_JSON_VALUES, MAX_TYPES
from kleinkram.recordings.decoding.schema import Layout

Decode = Callable[[bytes], Any]


def json_decode(name: str) -> Decode:
    """Return a function that decodes JSON messages to what they say, whatever their schema."""

    def decode(data: bytes) -> Any:
        raw = bytes(data)
        if sum(map(raw.count, (b",", b"[", b"{"))) > MAX_JSON_VALUES:
            raise DecodeError(name, f"more than {MAX_JSON_VALUES} values in one JSON message")
        try:
            value = json.loads(raw)
        except json.JSONDecodeError as error:
            raise DecodeError(name, f"it is no JSON: {error.msg}", offset=error.pos) from None
        except RecursionError:
            raise DecodeError(name, "its JSON nests too deep") from None
        except ValueError:  # no text, or a number of thousands of digits
            raise DecodeError(name, "it is no JSON that can be read") from None
        if raw.count(b"[") + raw.count(b"{") > MAX_JSON_DEPTH and _is_deep(value):
            raise DecodeError(name, f"its JSON nests more than {MAX_JSON_DEPTH} deep")
        return value

    return decode


def _is_deep(value: Any) -> bool:
    level = [value]
    for _ in range(MAX_JSON_DEPTH):
        level = [
            part
            for whole in level
            if isinstance(whole, (dict, list))
            for part in (whole.values() if isinstance(whole, dict) else whole)
            if isinstance(part, (dict, list))
        ]
        if not level:
            return False
    return True


def protobuf_decode(name: str, schema: bytes) -> tuple[Decode, Layout]:
    """Return a function that decodes messages of a type in a serialised `FileDescriptorSet`, and the type's layout.

    Every schema has a pool of its own: two recordings may define one name differently. Google's own files
    (`google/protobuf/timestamp.proto`) may be left out of the set.

    Raises:
        SchemaError: it is no such set, or does not define the type.
        ReadingExtraMissing: protobuf is not installed.
    """
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory
    except ImportError:
        raise ReadingExtraMissing("protobuf") from None
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
    except message.DecodeError:
        raise SchemaError("it is no FileDescriptorSet") from None
    pool = descriptor_pool.DescriptorPool()
    try:
        for file in _in_order({file.name: file for file in files}):
            pool.Add(file)
        made = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    except (TypeError, KeyError, ValueError) as error:
        raise SchemaError(f"its definitions contradict themselves: {str(error)[:200]}") from None

    def decode(data: bytes) -> Any:
        try:
            return made.FromString(bytes(data))
        except message.DecodeError:
            raise DecodeError(name, f"the {len(data)} bytes are no such protobuf message") from None

    return decode, _layout_of(made.DESCRIPTOR)


def _layout_of(root: Any) -> Layout:
    """Return names, numbers and types of all fields that a message can have, type by type in the order of use."""
    types = {root.full_name: root}
    layout: list[object] = []
    waiting = [root]
    while waiting:
        kind = waiting.pop()
        for field in kind.fields:
            part = field.message_type
            has_many = isinstance(field.default_value, list)
            layout.append((kind.full_name, field.name, field.number, field.type, has_many, part and part.full_name))
            if part is not None and part.full_name not in types:
                types[part.full_name] = part
                waiting.append(part)
    return tuple(layout)


def _in_order(files: dict[str, Any]) -> list[Any]:
    """Return files so that each comes behind those that it imports; Google's own are added where they are missing."""
    ordered: list[Any] = []
    seen: set[str] = set()
    waiting = [(name, False) for name in reversed(list(files))]
    while waiting:
        name, is_ready = waiting.pop()
        if is_ready:
            ordered.append(files[name])
            continue
        if name in seen:
            continue
        seen.add(name)
        if len(seen) > MAX_TYPES:
            raise SchemaError(f"more than {MAX_TYPES} files")
        if name not in files:
            files[name] = _known_file(name)
        waiting.append((name, True))
        waiting += [(needed, False) for needed in files[name].dependency]
    return ordered


def _known_file(name: str) -> Any:
    """Return the description of one of Google's own files."""
    from google.protobuf import (  # noqa: F401  # importing them makes them known to the default pool
        any_pb2,
        descriptor_pb2,
        descriptor_pool,
        duration_pb2,
        empty_pb2,
        field_mask_pb2,
        struct_pb2,
        timestamp_pb2,
        wrappers_pb2,
    )

    try:
        found = descriptor_pool.Default().FindFileByName(name)
    except KeyError:
        raise SchemaError(f"it needs {name[:100]}, which is not there") from None
    described = descriptor_pb2.FileDescriptorProto()
    found.CopyToProto(described)
    return described
