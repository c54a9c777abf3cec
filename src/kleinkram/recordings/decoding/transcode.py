"""Generates a Python function for each pair of message types that re-encodes messages between ROS 1 and CDR.

A message is never decoded: the function copies runs of bytes, and adds or skips what differs: the alignment of CDR, the
zero byte behind texts, and the sequence number of a header, which ROS 2 lacks. Arrays of numbers, and of types of fixed
size, are copied as a whole. As in `generate`, this is `exec` over untrusted schemas: nothing of a schema enters the
code except lengths, as integers.

It checks every length against the bytes that are there, and counts the elements of loops against `MAX_OBJECTS`.

Memory: three times the message.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn

from kleinkram.recordings.decoding.msg_definitions import short_name
from kleinkram.recordings.decoding.types import (
    MAX_OBJECTS,
    PRIMITIVES,
    Array,
    DecodeError,
    Field,
    Primitive,
    SchemaError,
    Struct,
    Type,
)
from kleinkram.recordings.decoding.wire import CDR_LE, Wire, is_numbers, min_size

Transcode = Callable[[bytes], bytes]
Columns = tuple[tuple[int, int], ...]  # where each byte of an element is, in the source and in the target

_STAMPS = frozenset(("time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"))
_HEADERS = frozenset(("std_msgs/Header", "roslib/Header"))
_COUNT = PRIMITIVES["uint32"]
_AS_FLAGS = bytes([0]) + bytes([1]) * 255
_PADDING = tuple(bytes(count) for count in range(8))
_CDR_HEADER = b"\0\1\0\0"
_HEAD = """\
def transcode(data):
    o, p, left = {start}, 0, {objects}
    out = [{front}]
    try:
        size = len(data)
        view = memoryview(data)
{body}
    except errors as error:
        fail(data, o, error)
    return join(out)
"""


def legal_name(name: str) -> str:
    """Return the name that a field has in ROS 2: lower case, without doubled, leading or closing underscores."""
    return re.sub("__+", "_", name.lower()).strip("_")


def pair_fields(source: Struct, target: Struct) -> Iterator[tuple[Field | None, Field | None]]:
    """Yield the fields that correspond; None for the sequence number of a header on the other side.

    Raises:
        SchemaError: they do not correspond, in the same order.
    """
    fields, others = [*source.fields], [*target.fields]
    if short_name(source.name) in _HEADERS and len(fields) != len(others):
        longer = fields if len(fields) > len(others) else others
        if len(longer) - min(len(fields), len(others)) == 1 and longer[0].name == "seq":
            sequence = longer.pop(0)
            yield (sequence, None) if longer is fields else (None, sequence)
    are_stamps = {short_name(source.name), short_name(target.name)} <= _STAMPS
    names, other_names = ([legal_name(field.name) for field in part] for part in (fields, others))
    if len(names) != len(other_names) or (names != other_names and not are_stamps):
        raise SchemaError(f"{source.name} has the fields {_shown(names)}, and {target.name} has {_shown(other_names)}")
    yield from zip(fields, others, strict=True)


def _shown(names: list[str]) -> str:
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")


def check_pair(source: Type, target: Type, where: str = "it") -> None:
    """Raise `SchemaError` if values of one type cannot be values of the other."""
    if isinstance(source, Struct) and isinstance(target, Struct):
        for field, other in pair_fields(source, target):
            is_time = short_name(source.name) in _STAMPS
            if field is not None and other is not None and not (is_time and _are_words(field.type, other.type)):
                check_pair(field.type, other.type, f"{source.name}.{field.name}")
    elif isinstance(source, Array) and isinstance(target, Array) and source.length == target.length:
        check_pair(source.element, target.element, where)
    elif not isinstance(source, Primitive) or not isinstance(target, Primitive):
        raise SchemaError(f"{where} has another type in the other version of ROS")
    elif "wstring" in (source.name, target.name):
        raise SchemaError(f"{where} is a wide text, which ROS 1 does not have")
    elif source != target and {source.code, target.code} != {"b", "B"}:  # `byte` is signed in ROS 1 only
        raise SchemaError(f"{where} is {source.name}, and {target.name} in the other version of ROS")


def _are_words(source: Type, target: Type) -> bool:
    """Return whether both are numbers of 32 bits, signed or not, as those of times are."""
    return all(isinstance(kind, Primitive) and kind.code in ("i", "I") for kind in (source, target))


def transcoder(source: Struct, target: Struct, source_wire: Wire, target_wire: Wire) -> Transcode:
    """Return the function that re-encodes a message between `ROS1` and `CDR_LE`.

    It raises `DecodeError` and nothing else: for bytes that are no such message, and for a time that the other side
    cannot express.

    Raises:
        SchemaError: the types do not correspond.
    """
    check_pair(source, target)
    if not source.fields:
        return _empty(source.name, source_wire, target_wire)
    writer = _TranscoderWriter(source_wire, target_wire)
    writer.namespace.update(
        errors=(struct.error, ValueError, IndexError, OverflowError),
        u32=struct.Struct("<I").unpack_from,
        pack=struct.Struct("<I").pack,
        join=b"".join,
        pads=_PADDING,
        as_flags=_AS_FLAGS,
        with_flag=_with_flag,
        restride=_restride,
        **_failures(source.name),
    )
    writer.namespace["__builtins__"] = {"len": len, "range": range, "memoryview": memoryview}
    if source_wire is CDR_LE:
        writer.line("if data[1] != 1 or data[0]: unusual()")
    writer.struct(source, target)
    writer.end()
    front = repr(_CDR_HEADER) if target_wire is CDR_LE else ""
    body = "\n".join(writer.lines)
    code = _HEAD.format(start=source_wire.start, objects=MAX_OBJECTS, front=front, body=body)
    exec(compile(code, f"<transcoder of {source.name[:80]!a}>", "exec"), writer.namespace)  # noqa: S102  # see above
    transcode: Transcode = writer.namespace["transcode"]
    return transcode


def _empty(name: str, source_wire: Wire, target_wire: Wire) -> Transcode:
    """Return the function for messages without fields. The one byte of such a type may be missing at the end."""
    most = source_wire.start + source_wire.empty_size + source_wire.padding
    result = (_CDR_HEADER if target_wire is CDR_LE else b"") + bytes(target_wire.empty_size)

    def transcode(data: bytes) -> bytes:
        if not source_wire.start <= len(data) <= most:
            raise DecodeError(name, f"{len(data)} bytes are no message without fields")
        return result

    return transcode


def _failures(name: str) -> dict[str, Callable[..., NoReturn]]:
    """Return the functions that raise what is wrong with a message of a type."""

    def fail(data: bytes, offset: int, error: Exception | None) -> NoReturn:
        message = f"the {len(data)} bytes end too early or are not such a message"
        raise DecodeError(name, message, offset=offset) from error

    def short(claimed: int, size: int, offset: int) -> NoReturn:
        message = f"{claimed} elements or bytes are claimed; the message has {size} bytes"
        raise DecodeError(name, message, offset=offset)

    def wrong_end(size: int, offset: int) -> NoReturn:
        message = f"its fields take {offset} of its {size} bytes: the definition does not match the message"
        raise DecodeError(name, message, offset=offset)

    def unfit(offset: int) -> NoReturn:
        raise DecodeError(name, "a time that the other version of ROS cannot express", offset=offset)

    def unusual() -> NoReturn:
        raise DecodeError(name, "it is not in plain little-endian CDR", offset=0)

    return {"fail": fail, "short": short, "wrong_end": wrong_end, "unfit": unfit, "unusual": unusual}


def _with_flag(data: bytes, offset: int) -> tuple[bytes, memoryview]:
    """Return a message whose truth value at an offset is 1: CDR knows no other than 0 and 1."""
    changed = bytearray(data)
    changed[offset] = 1
    return bytes(changed), memoryview(changed)


def _restride(elements: bytes, count: int, stride: int, target_stride: int, target_bytes: int, at: Columns) -> bytes:
    """Return elements of fixed size with other gaps between and in them."""
    result = bytearray(count * target_stride)
    for offset, target_offset in at:
        result[target_offset::target_stride] = elements[offset::stride]
    return bytes(result[:target_bytes])


@dataclass
class _Position:
    """What is known of the position `variable + ahead`: counted from the start, it is `residue` modulo `modulus`."""

    variable: str
    wire: Wire
    ahead: int = 0
    modulus: int = 8
    residue: int = 0

    def at(self, beyond: int = 0) -> str:
        ahead = self.ahead + beyond
        return f"{self.variable} + {ahead}" if ahead else self.variable

    def move(self, size: int) -> None:
        self.ahead += size
        self.residue += size

    def step_to(self, size: int) -> int | None:
        """Return how far the next position is where a number of `size` bytes may stand; None if that is not known."""
        size = min(size, self.wire.alignment)
        return -self.residue % size if size <= self.modulus else None

    def forget(self, modulus: int = 1) -> None:
        """Note that the position is `variable` itself, a multiple of `modulus`."""
        self.ahead, self.modulus, self.residue = 0, modulus, 0


@dataclass(frozen=True)
class _Fixed:
    """An element of fixed size: `offsets` of its numbers, with their sizes. `stride`: from one element to the next."""

    offsets: tuple[tuple[int, int], ...]
    size: int
    stride: int
    alignment: int


class _TranscoderWriter:
    """Collects the lines of one function. `pieces` of the output refer to the position in the source as it is now."""

    def __init__(self, source_wire: Wire, target_wire: Wire) -> None:
        self.lines: list[str] = []
        self.namespace: dict[str, Any] = {}
        self._source = _Position("o", source_wire)
        self._target = _Position("p", target_wire)
        self._pieces: list[str | list[int]] = []
        self._indent = 2
        self._names = 0

    def line(self, text: str) -> None:
        self.lines.append("    " * self._indent + text)

    def struct(self, source: Struct, target: Struct) -> None:
        """Re-encode a type's fields."""
        for field, other in pair_fields(source, target):
            if other is None:
                self._align_source(_COUNT.size)
                self._source.move(_COUNT.size)
            elif field is None:
                self._align_target(_COUNT.size)
                self._put(repr(bytes(_COUNT.size)), _COUNT.size)
            else:
                self._value(field.type, other.type)
        if not source.fields:
            self._source.move(self._source.wire.empty_size)
            if self._target.wire.empty_size:
                self._put(repr(bytes(self._target.wire.empty_size)), self._target.wire.empty_size)

    def end(self) -> None:
        """Write what is left; refuse a message that ends elsewhere than its fields."""
        self._flush()
        at = self._source.at()
        self.line(f"if not 0 <= size - ({at}) <= {self._source.wire.padding}: wrong_end(size, {at})")

    def _value(self, source: Type, target: Type) -> None:
        if isinstance(source, Struct) and isinstance(target, Struct):
            self.struct(source, target)
        elif isinstance(source, Array) and isinstance(target, Array):
            self._array(source, target)
        elif isinstance(source, Primitive) and isinstance(target, Primitive):
            if source.code:
                self._number(source, target)
            else:
                self._text()

    def _name(self, prefix: str) -> str:
        self._names += 1
        return f"{prefix}{self._names}"

    def _put(self, piece: str, size: int) -> None:
        self._pieces.append(piece)
        self._target.move(size)

    def _copy(self, size: int) -> None:
        """Copy bytes of the source as they are."""
        start, last = self._source.ahead, self._pieces[-1] if self._pieces else None
        if isinstance(last, list) and last[1] == start:
            last[1] += size
        else:
            self._pieces.append([start, start + size])
        self._source.move(size)
        self._target.move(size)

    def _flush(self) -> None:
        if self._pieces:
            texts = [piece if isinstance(piece, str) else self._slice(*piece) for piece in self._pieces]
            self.line(f"out += ({', '.join(texts)},)")
        self._pieces = []

    def _slice(self, start: int, end: int) -> str:
        return f"data[o + {start}:o + {end}]" if start else f"data[o:o + {end}]"

    def _settle_source(self, modulus: int = 1) -> None:
        """Bring `o` to the position in the source."""
        self._flush()
        if self._source.ahead:
            self.line(f"o += {self._source.ahead}")
        self._source.forget(modulus)

    def _settle_target(self, modulus: int = 1) -> None:
        if self._target.ahead:
            self.line(f"p += {self._target.ahead}")
        self._target.forget(modulus)

    def _align_source(self, size: int, condition: str = "") -> None:
        step = None if condition else self._source.step_to(size)
        if step is not None:
            self._source.move(step)
            return
        size = min(size, self._source.wire.alignment)
        self._settle_source(size)
        origin = self._source.wire.start % size
        if size > 1:
            self.line(f"{condition}o = (o + {size - 1 - origin} & -{size}) + {origin}")

    def _align_target(self, size: int, condition: str = "") -> None:
        step = None if condition else self._target.step_to(size)
        if step is not None:
            if step:
                self._put(repr(bytes(step)), step)
            return
        size = min(size, self._target.wire.alignment)
        if size == 1:
            self._settle_target()
            return
        gap = self._name("q")
        self.line(f"{gap} = -({self._target.at()}) & {size - 1}{condition}")
        self.line(f"p += {gap} + {self._target.ahead}" if self._target.ahead else f"p += {gap}")
        self._pieces.append(f"pads[{gap}]")
        self._target.forget(size)

    def _number(self, source: Primitive, target: Primitive) -> None:
        self._align_source(source.size)
        self._align_target(source.size)
        if source.code == "?":
            at = self._source.at()
            self.line(f"if data[{at}] > 1: data, view = with_flag(data, {at})")
        elif source.size > 1 and source.code != target.code:
            at = self._source.at(source.size - 1)
            self.line(f"if data[{at}] > 127: unfit({at})")
        self._copy(source.size)

    def _count(self) -> str:
        """Read a length of 4 bytes; returns its name. Neither position moves."""
        name = self._name("n")
        self._align_source(_COUNT.size)
        self._align_target(_COUNT.size)
        self.line(f"{name}, = u32(data, {self._source.at()})")
        return name

    def _text(self) -> None:
        count, end = self._count(), self._name("e")
        start = self._source.at(_COUNT.size)
        self.line(f"{end} = {start} + {count}")
        self.line(f"if {end} > size: short({count}, size, o)")
        if self._source.wire.counts_nul:
            length = self._name("m")
            self.line(f"{length} = {count} - 1 if {count} else 0")
            self._put(f"pack({length}), data[{start}:{start} + {length}]", _COUNT.size)
        else:
            length = f"{count} + 1"
            self._put(f"pack({length}), data[{start}:{end}], {bytes(1)!r}", _COUNT.size)
        self._flush()
        self.line(f"o = {end}")
        self.line(f"p += {self._target.ahead} + {length}")
        self._source.forget()
        self._target.forget()

    def _array(self, source: Array, target: Array) -> None:
        if is_numbers(source) and source.length is not None:
            self._fixed_numbers(source, source.length)
            return
        sides = [_fixed(kind.element, at.wire) for kind, at in ((source, self._source), (target, self._target))]
        if source.length is None and sides[0] is not None and sides[1] is not None:
            self._whole(sides[0], sides[1], is_flags=source.element == PRIMITIVES["bool"])
        else:
            self._loop(source, target)

    def _fixed_numbers(self, kind: Array, length: int) -> None:
        if not length or not isinstance(kind.element, Primitive):
            return
        size = length * kind.element.size
        self._align_source(kind.element.size)
        self._align_target(kind.element.size)
        if kind.element.code == "?":
            self._put(f"data[{self._source.at()}:{self._source.at(size)}].translate(as_flags)", size)
            self._source.move(size)
        else:
            self._copy(size)

    def _whole(self, source: _Fixed, target: _Fixed, *, is_flags: bool) -> None:
        """Re-encode all elements of fixed size at once."""
        count = self._count()
        self._copy(_COUNT.size)
        self._settle_source(min(4, self._source.wire.alignment))
        self._settle_target(min(4, self._target.wire.alignment))
        if source.alignment > 4:
            self._align_source(source.alignment, f"if {count}: ")
        if target.alignment > 4:
            self._align_target(target.alignment, f" if {count} else 0")
        end, length = self._name("e"), self._name("m")
        self.line(f"{end} = o + ({count} - 1) * {source.stride} + {source.size} if {count} else o")
        self.line(f"if {end} > size: short({count}, size, o)")
        if (source.stride, source.offsets) == (target.stride, target.offsets):
            self._pieces.append(f"data[o:{end}].translate(as_flags)" if is_flags else f"view[o:{end}]")
            length = f"{end} - o"
        else:
            self.line(f"{length} = ({count} - 1) * {target.stride} + {target.size} if {count} else 0")
            columns = self._name("c")
            self.namespace[columns] = _columns(source, target)
            strides = f"{source.stride}, {target.stride}, {length}, {columns}"
            self._pieces.append(f"restride(data[o:{end}], {count}, {strides})")
        self._flush()
        self.line(f"p += {length}")
        self.line(f"o = {end}")
        self._source.forget()
        self._target.forget()

    def _loop(self, source: Array, target: Array) -> None:
        if source.length is None:
            count = self._count()
            self._copy(_COUNT.size)
        else:
            count = str(source.length)
        self._settle_source()
        self._settle_target()
        minimum = min_size(source.element, self._source.wire)
        self.line(f"left -= {count}")
        self.line(f"if left < 0 or {count} * {minimum} > size - o: short({count}, size, o)")
        self.line(f"for {self._name('i')} in range({count}):")
        self._indent += 1
        before = len(self.lines)
        self._value(source.element, target.element)
        self._settle_source()
        self._settle_target()
        if len(self.lines) == before:
            self.line("continue")
        self._indent -= 1


def _fixed(kind: Type, wire: Wire) -> _Fixed | None:
    """Return the layout of elements of fixed size; None if it varies from element to element, or bytes must change."""
    numbers = [*_numbers_in(kind)]
    if not numbers or None in numbers:
        return None
    sizes = [number.size for number in numbers if number is not None]
    alignments = [min(size, wire.alignment) for size in sizes]
    if alignments[0] != max(alignments):
        return None
    at, offsets = 0, []
    for size, alignment in zip(sizes, alignments, strict=True):
        at += -at % alignment
        offsets.append((at, size))
        at += size
    return _Fixed(tuple(offsets), at, at + -at % alignments[0], alignments[0])


def _numbers_in(kind: Type) -> Iterator[Primitive | None]:
    """Yield the numbers of which a type consists; None where it has a variable size, a truth value or a time."""
    if isinstance(kind, Primitive):
        yield kind if kind.code else None
    elif isinstance(kind, Array):
        if kind.length is None or kind.length > _MAX_INLINE or not is_numbers(kind):
            yield None
        else:
            yield from [_plain(kind.element)] * kind.length
    elif not kind.fields or short_name(kind.name) in _STAMPS:
        yield None
    else:
        for field in kind.fields:
            yield from [_plain(field.type)] if isinstance(field.type, Primitive) else _numbers_in(field.type)


_MAX_INLINE = 256  # elements of an array within an element of fixed size


def _plain(kind: Type) -> Primitive | None:
    return kind if isinstance(kind, Primitive) and kind.code not in ("", "?") else None


def _columns(source: _Fixed, target: _Fixed) -> Columns:
    pairs = zip(source.offsets, target.offsets, strict=True)
    return tuple((one + byte, other + byte) for (one, size), (other, _) in pairs for byte in range(size))
