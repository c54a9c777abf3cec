"""The bytes and sizes that pictures and point clouds carry, whatever encoding their message had."""

from __future__ import annotations

import base64
import binascii
from typing import Any

from kleinkram.recordings.decoding.errors import DecodeError
from kleinkram.recordings.decoding.values import part


def type_name(value: Any) -> str:
    """Return the name of a decoded message's type, for errors."""
    return str(getattr(value, "_type", "") or getattr(getattr(value, "DESCRIPTOR", None), "full_name", ""))


def payload(value: object) -> Any:
    """Return the field `data` as something with the buffer interface and a length in bytes; JSON has it in base64.

    Raises:
        DecodeError: it is neither bytes nor base64.
    """
    data = part(value, "data")
    if isinstance(data, str):
        try:
            return base64.b64decode(data, validate=True)
        except binascii.Error:
            raise DecodeError(type_name(value), "its data are no base64") from None
    try:
        return memoryview(data).cast("B") if len(data) else b""
    except (TypeError, ValueError):
        raise DecodeError(type_name(value), "its data are no bytes") from None


def whole_number(value: object, name: str) -> int:
    """Return a size.

    Raises:
        DecodeError: it is missing, no whole number, or negative.
    """
    number = part(value, name)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**32:
        raise DecodeError(type_name(value), f"its {name} is {str(number)[:40]}, which is no size")
    return number
