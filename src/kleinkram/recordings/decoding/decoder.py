"""Builds the decoder of a channel: ROS 1, CDR, JSON or protobuf."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from kleinkram.recordings.decoding import types
from kleinkram.recordings.decoding.generate import Decode, generate
from kleinkram.recordings.decoding.idl_definitions import parse_idl
from kleinkram.recordings.decoding.msg_definitions import Ros, parse_msg, well_known_definitions
from kleinkram.recordings.decoding.types import (
    DecodeError,
    Layout,
    ReadingExtraMissing,
    SchemaError,
    Struct,
    Undecodable,
)
from kleinkram.recordings.decoding.values import Value
from kleinkram.recordings.decoding.wire import CDR_LE, ENCAPSULATIONS, OTHER_ENCAPSULATIONS, ROS1


def json_decode(name: str) -> Callable[[bytes], Any]:
    """Return a function that decodes JSON messages with any schema."""

    def decode(data: bytes) -> Any:
        raw = bytes(data)
        if sum(map(raw.count, (b",", b"[", b"{"))) > types.MAX_JSON_VALUES:
            raise DecodeError(name, f"more than {types.MAX_JSON_VALUES} values in one JSON message")
        try:
            value = json.loads(raw)
        except json.JSONDecodeError as error:
            raise DecodeError(name, f"it is not JSON: {error.msg}", offset=error.pos) from None
        except RecursionError:
            raise DecodeError(name, "its JSON nests too deeply") from None
        except ValueError:  # no text, or a number of thousands of digits
            raise DecodeError(name, "its JSON cannot be read") from None
        if raw.count(b"[") + raw.count(b"{") > types.MAX_JSON_DEPTH and _is_deep(value):
            raise DecodeError(name, f"its JSON nests more than {types.MAX_JSON_DEPTH} deep")
        return value

    return decode


def _is_deep(value: Any) -> bool:
    level = [value] if isinstance(value, (dict, list)) else []
    for _ in range(types.MAX_JSON_DEPTH):
        parts = [part for whole in level for part in (whole.values() if isinstance(whole, dict) else whole)]
        level = [part for part in parts if isinstance(part, (dict, list))]
        if not level:
            return False
    return True


def protobuf_decode(name: str, schema: bytes) -> tuple[Callable[[bytes], Any], Layout]:
    """Return a decoder for a type in a serialised `FileDescriptorSet`, and the type's layout.

    Every schema has its own pool: two recordings may define one name differently. The set may lack Google's own files.
    """
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory
    except ImportError:
        raise ReadingExtraMissing("protobuf") from None
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
    except message.DecodeError:
        raise SchemaError("it is not a FileDescriptorSet") from None
    pool = descriptor_pool.DescriptorPool()
    try:
        for file in _in_order({file.name: file for file in files}):
            pool.Add(file)
        made = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    except (TypeError, KeyError, ValueError) as error:
        raise SchemaError(f"its definitions are inconsistent: {str(error)[:200]}") from None

    def decode(data: bytes) -> Any:
        try:
            return made.FromString(bytes(data))
        except message.DecodeError:
            raise DecodeError(name, f"the {len(data)} bytes are not such a protobuf message") from None

    return decode, _layout_of(made.DESCRIPTOR)


def _layout_of(root: Any) -> Layout:
    """Return names, numbers and types of all fields that a message can have, type by type in the order of use."""
    known_types = {root.full_name: root}
    layout: list[object] = []
    waiting = [root]
    while waiting:
        kind = waiting.pop()
        for field in kind.fields:
            part = field.message_type
            has_many = isinstance(field.default_value, list)
            layout.append((kind.full_name, field.name, field.number, field.type, has_many, part and part.full_name))
            if part is not None and part.full_name not in known_types:
                known_types[part.full_name] = part
                waiting.append(part)
    return tuple(layout)


def _in_order(files: dict[str, Any]) -> list[Any]:
    """Return files in dependency order; Google's own are added where they are missing."""
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
        if len(seen) > types.MAX_TYPES:
            raise SchemaError(f"more than {types.MAX_TYPES} files")
        if name not in files:
            files[name] = _known_file(name)
        waiting.append((name, True))
        waiting += [(needed, False) for needed in files[name].dependency]
    return ordered


def _known_file(name: str) -> Any:
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
        descriptor = descriptor_pool.Default().FindFileByName(name)
    except KeyError:
        raise SchemaError(f"it needs {name[:100]}, which is missing") from None
    described = descriptor_pb2.FileDescriptorProto()
    descriptor.CopyToProto(described)
    return described


@dataclass(frozen=True)
class Decoder:
    """Decodes the messages of one schema.

    Attributes:
        decode: takes the bytes of a message, which arrays in the result keep alive; raises `DecodeError` and nothing
            else. Returns a `Value` for ROS, what `json` returns for JSON, a message of the definition's own class for
            protobuf. Texts are UTF-8, with U+FFFD for what is not.
        struct: the type of ROS messages; None for others.
        layout: equal for schemas whose messages are decoded to the same fields and types.
    """

    type_name: str
    message_encoding: str
    decode: Callable[[bytes], object]
    struct: Struct | None
    layout: Layout


@lru_cache(maxsize=512)
def decoder_for(
    message_encoding: str, schema_name: str, schema_encoding: str, schema_data: bytes
) -> Decoder | Undecodable:
    """Return the decoder of a channel's messages, or why they cannot be decoded. Cached.

    CDR messages without a definition use that of `well_known.txt`, if there is one. The encodings are spelled as in
    MCAP.
    """
    if len(schema_data) > types.MAX_SCHEMA_BYTES:
        return Undecodable(
            schema_name, f"its schema has {len(schema_data)} bytes; at most {types.MAX_SCHEMA_BYTES} are read"
        )
    try:
        return _decoder(message_encoding, schema_name, schema_encoding, schema_data)
    except SchemaError as error:
        return Undecodable(schema_name, f"its schema cannot be read: {error}")
    except ReadingExtraMissing as error:
        return Undecodable(schema_name, str(error))


def _decoder(message_encoding: str, name: str, schema_encoding: str, data: bytes) -> Decoder | Undecodable:
    if message_encoding == "json":
        return Decoder(name, message_encoding, json_decode(name), None, ())
    if message_encoding == "protobuf" and schema_encoding == "protobuf":
        decode, layout = protobuf_decode(name, data)
        return Decoder(name, message_encoding, decode, None, layout)
    if message_encoding == "cdr" and not data.strip():
        texts = well_known_definitions(name)
        if not texts and not schema_encoding:
            return Undecodable(name, "the recording has no definition of it, and it is not one of the common types")
        if texts:
            return _well_known(name, [parse_msg(name, text, Ros.two) for text in texts])
    parse = _PARSERS.get((message_encoding, schema_encoding))
    if parse is None:
        how = f"with a schema in '{schema_encoding}'" if schema_encoding else "without a schema"
        return Undecodable(name, f"messages encoded as '{message_encoding}' {how} are not decoded")
    if not data.strip() and name.rpartition("/")[2] not in _EMPTY_NAMES:
        return Undecodable(name, "its definition is missing: the recording has an empty one")
    struct = parse(name, data.decode("utf-8", "replace"))
    decode = generate(struct, ROS1) if message_encoding == "ros1" else _cdr(struct)
    return Decoder(name, message_encoding, decode, struct, types.layout_of(struct))


# Types without fields are called so in every package; should one hold bytes all the same, these are left over.
_EMPTY_NAMES = frozenset(
    ("Empty", "Empty_Request", "Empty_Response", "EmptyRequest", "EmptyResponse", "TriggerRequest", "Trigger_Request")
)


def _well_known(name: str, structs: list[Struct]) -> Decoder:
    """Return the decoder of a well-known type: the first of several definitions that fits a message."""
    first, *others = [_cdr(struct) for struct in structs]

    def decode(data: bytes) -> Value:
        try:
            return first(data)
        except DecodeError:
            fitting: list[Value] = []
            for other in others:
                with suppress(DecodeError):
                    fitting.append(other(data))
            if len(fitting) != 1:
                raise
            return fitting[0]

    return Decoder(name, "cdr", decode if others else first, structs[0], types.layout_of(structs[0]))


_PARSERS: dict[tuple[str, str], Callable[[str, str], Struct]] = {
    ("ros1", "ros1msg"): lambda name, text: parse_msg(name, text, Ros.one),
    ("cdr", "ros2msg"): lambda name, text: parse_msg(name, text, Ros.two),
    ("cdr", "ros2idl"): parse_idl,
    ("cdr", "omgidl"): parse_idl,
}


def _cdr(struct: Struct) -> Decode:
    """Return a decoder for all plain forms of CDR; the unusual ones are generated on first use."""
    functions = {1: generate(struct, CDR_LE)}
    usual = functions[1]

    def decode(data: bytes) -> object:
        if len(data) < 4 or data[0]:
            raise DecodeError(struct.name, "it does not start with a CDR header", offset=0)
        kind = data[1]
        if kind == 1:
            return usual(data)
        if kind not in functions:
            if kind not in ENCAPSULATIONS:
                name = OTHER_ENCAPSULATIONS.get(kind, f"number {kind}")
                raise DecodeError(struct.name, f"it is encoded as {name}, which is not decoded", offset=0)
            functions[kind] = generate(struct, ENCAPSULATIONS[kind])
        return functions[kind](data)

    return decode  # type: ignore[return-value]  # every function makes values
