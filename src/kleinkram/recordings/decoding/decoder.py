"""From a channel's schema to the function that decodes its messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

from kleinkram.recordings.decoding.errors import DecodeError, ReadingExtraMissing, SchemaError, Undecodable
from kleinkram.recordings.decoding.generate import Decode, generate
from kleinkram.recordings.decoding.idl_text import parse_idl
from kleinkram.recordings.decoding.limits import MAX_SCHEMA_BYTES
from kleinkram.recordings.decoding.msg_text import Ros, parse_msg
from kleinkram.recordings.decoding.other_encodings import json_decode, protobuf_decode
from kleinkram.recordings.decoding.schema import Layout, Struct, layout_of
from kleinkram.recordings.decoding.values import Value
from kleinkram.recordings.decoding.well_known import well_known_definitions
from kleinkram.recordings.decoding.wire import CDR_LE, ENCAPSULATIONS, OTHER_ENCAPSULATIONS, ROS1


@dataclass(frozen=True)
class Decoder:
    """Decodes the messages of one schema.

    Attributes:
        type_name: the schema's name.
        message_encoding: "cdr", "ros1", "json" or "protobuf".
        decode: (bytes or memoryview of a message) -> its value; raises `DecodeError` and nothing else. A `Value` for
            ROS, what `json` makes of it for JSON, a message of the definition's own class for protobuf. Texts are
            UTF-8, with U+FFFD for what is not. Arrays are views: they keep the bytes that were given alive.
        struct: the layout of a ROS type; None for others.
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
    """Return the decoder of a channel's messages, or why there is none. Cached.

    Where CDR messages have no definition, those of `well_known` count, if there are any.
    The encodings are spelled as in MCAP; a ROS 1 bag is ("ros1", type, "ros1msg", message_definition).
    """
    if len(schema_data) > MAX_SCHEMA_BYTES:
        return Undecodable(schema_name, f"its schema has {len(schema_data)} bytes; at most {MAX_SCHEMA_BYTES} are read")
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
            return Undecodable(name, "the recording holds no definition of it, and it is none of the common types")
        if texts:
            return _well_known(name, [parse_msg(name, text, Ros.two) for text in texts])
    parse = _PARSERS.get((message_encoding, schema_encoding))
    if parse is None:
        how = f"with a schema in '{schema_encoding}'" if schema_encoding else "without a schema"
        return Undecodable(name, f"messages encoded as '{message_encoding}' {how} are not decoded")
    if not data.strip() and name.rpartition("/")[2] not in _EMPTY_NAMES:
        return Undecodable(name, "its definition is missing: the recording holds an empty one")
    struct = parse(name, data.decode("utf-8", "replace"))
    decode = generate(struct, ROS1) if message_encoding == "ros1" else _cdr(struct)
    return Decoder(name, message_encoding, decode, struct, layout_of(struct))


# Types without fields are called so in every package; should one hold bytes all the same, these are left over.
_EMPTY_NAMES = frozenset(
    ("Empty", "Empty_Request", "Empty_Response", "EmptyRequest", "EmptyResponse", "TriggerRequest", "Trigger_Request")
)


def _well_known(name: str, structs: list[Struct]) -> Decoder:
    """Return the decoder of a type whose recording has no definition: by the first that explains a message."""
    first, *others = [_cdr(struct) for struct in structs]

    def decode(data: bytes) -> Value:
        try:
            return first(data)
        except DecodeError:
            fitting = [value for other in others if (value := _decoded(other, data)) is not None]
            if len(fitting) != 1:
                raise
            return fitting[0]

    return Decoder(name, "cdr", decode if others else first, structs[0], layout_of(structs[0]))


def _decoded(decode: Decode, data: bytes) -> Value | None:
    try:
        return decode(data)
    except DecodeError:
        return None


_PARSERS: dict[tuple[str, str], Callable[[str, str], Struct]] = {
    ("ros1", "ros1msg"): lambda name, text: parse_msg(name, text, Ros.one),
    ("cdr", "ros2msg"): lambda name, text: parse_msg(name, text, Ros.two),
    ("cdr", "ros2idl"): parse_idl,
    ("cdr", "omgidl"): parse_idl,
}


def _cdr(struct: Struct) -> Decode:
    """Return a decoder for any of CDR's plain forms: the usual one first, others made when one is met."""
    functions = {1: generate(struct, CDR_LE)}
    usual = functions[1]

    def decode(data: bytes) -> object:
        if len(data) < 4 or data[0]:
            raise DecodeError(struct.name, "it does not begin with the header of a CDR message", offset=0)
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
