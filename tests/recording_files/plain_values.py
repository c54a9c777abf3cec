"""Values of messages as any library decodes them, comparable with each other; and decoders of `rosbags`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kleinkram.recordings.decoding.transcode import legal_name

_SCALARS = (int, float, str, bool)
_NAMES: dict[str, str | None] = {
    "secs": "sec",
    "nsecs": "nanosec",
    "structure_needs_at_least_one_member": None,
    "seq": None,
}


def plain(value: Any) -> Any:
    """Return a value of any library as dicts by the names of ROS 2, lists, and numbers; without sequence numbers."""
    kind = type(value)
    if kind in _SCALARS:
        return value
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, dict):
        return {name: plain(part) for own, part in value.items() if (name := _plain_name(own))}
    if is_dataclass(value):
        return {name: plain(getattr(value, own)) for own, name in _field_names(kind)}  # type: ignore[arg-type]  # types are hashable
    return value


@cache
def _plain_name(name: str) -> str | None:
    return _NAMES.get(name, legal_name(name))


@cache
def _field_names(kind: type[Any]) -> list[tuple[str, str]]:
    """Return the names of the fields of a message, without constants, and the names in ROS 2."""
    own = [one.name for one in fields(kind) if not hasattr(kind, one.name)]
    return [(one, name) for one in own if (name := _plain_name(one))]


@cache
def rosbags_decoder(message_encoding: str, name: str, definition: str) -> Callable[[bytes], Any]:
    """Return what decodes messages of a type by its definition; "ros1" or "cdr"."""
    store = get_typestore(Stores.EMPTY)
    full_name = name if name.count("/") == 2 else name.replace("/", "/msg/")
    store.register(get_types_from_msg(definition.replace("# no fields\n", ""), full_name))
    decode = store.deserialize_ros1 if message_encoding == "ros1" else store.deserialize_cdr
    return lambda data: plain(decode(data, full_name))
