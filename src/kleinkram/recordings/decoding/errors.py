"""What can go wrong between a schema, a message and a value."""

from __future__ import annotations

from dataclasses import dataclass

from kleinkram.recordings.errors import RecordingError


class SchemaError(RecordingError):
    """A schema cannot be followed. Never leaves `decoding`: it becomes an `Undecodable`."""


class DecodeError(RecordingError):
    """A message's bytes contradict its schema, or a value is not what was asked for.

    Attributes:
        type_name: the type that was being read.
        offset: the byte of the message at which it was noticed, or None where no byte is to blame.
    """

    def __init__(self, type_name: str, message: str, *, offset: int | None = None) -> None:
        where = "" if offset is None else f" (near byte {offset} of the message)"
        super().__init__(f"{type_name or 'a message'}: {message}{where}")
        self.type_name = type_name
        self.offset = offset

    def __reduce__(self) -> tuple[object, ...]:
        return (_again, (str(self), self.type_name, self.offset))


def _again(text: str, type_name: str, offset: int | None) -> DecodeError:
    error = DecodeError(type_name, "", offset=offset)
    error.args = (text,)
    return error


class ReadingExtraMissing(RecordingError):
    """A library of the extra `reading` is not installed."""

    def __init__(self, library: str) -> None:
        super().__init__(f"this needs {library}: run `pip install 'open-kleinkram[reading]'`")
        self.library = library

    def __reduce__(self) -> tuple[object, ...]:
        return (ReadingExtraMissing, (self.library,))


@dataclass(frozen=True)
class Undecodable:
    """Why messages of a schema cannot be decoded; their bytes can still be read.

    Attributes:
        type_name: the schema's name.
        reason: a sentence for a person.
    """

    type_name: str
    reason: str
