"""Generates a Python function for each message type that decodes its messages fast.

The generated function reads runs of numbers with one `struct` call each, computes alignment in advance wherever the
position is known, and inlines nested types. A schema is untrusted text, and this is `exec`: nothing of it enters the
code except field names, which `types.identifier` restricts to letters, digits and underscores with a letter in front,
never a keyword, and only behind a dot (`v3.frame_id = ...`). Classes, formats and dtypes enter as objects under names
made here (`c0`, `u1`), lengths as integers. Builtins are out of reach; `MAX_FIELDS` bounds the size of the code.

It checks every length against the bytes that are there before it allocates, and counts objects against `MAX_OBJECTS`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, NoReturn

from kleinkram.recordings.decoding.types import MAX_OBJECTS, PRIMITIVES, Array, DecodeError, Primitive, Struct, Type
from kleinkram.recordings.decoding.values import Value, value_class
from kleinkram.recordings.decoding.wire import (
    NumberReader,
    Wire,
    is_numbers,
    min_size,
    number_reader,
    object_count,
    read_wide,
)

Decode = Callable[[bytes], Value]
_COUNT = PRIMITIVES["uint32"]
_HEAD = """\
def decode(data):
    o = {start}
    left = {objects}
    try:
        size = len(data)
{body}
    except errors as error:
        fail(data, o, error)
    return v0
"""


def generate(root: Struct, wire: Wire) -> Decode:
    """Return the function that decodes a message of a type; it raises `DecodeError` and nothing else."""
    reads = number_reader(wire.order)
    writer = _CodeWriter(wire, reads)
    writer.namespace.update(
        errors=(struct.error, ValueError, IndexError, OverflowError, TypeError),
        **_failures(root.name),
        read_wide=read_wide,
        numbers=reads.numbers,
        flags=reads.flags,
        nothing=reads.nothing,
    )
    writer.namespace["__builtins__"] = {"len": len, "str": str, "range": range}
    if root.fields:  # the one byte of a type without fields is not missed at the end of a message
        writer.struct(root)
        writer.flush()
        writer.check_end()
    else:
        writer.line(f"if size > {wire.start + wire.empty_size + wire.padding}: left_over(size, {wire.start})")
        writer.line(f"v0 = {writer.constant('c', value_class(root))}()")
    source = _HEAD.format(start=wire.start, objects=MAX_OBJECTS, body="\n".join(writer.lines))
    exec(compile(source, f"<decoder of {root.name[:80]!a}>", "exec"), writer.namespace)  # noqa: S102  # see the docstring
    decode: Decode = writer.namespace["decode"]
    return decode


def _failures(name: str) -> dict[str, Callable[..., NoReturn]]:
    """Return the functions that raise what is wrong with a message of a type."""

    def fail(data: bytes, offset: int, error: Exception | None) -> NoReturn:
        message = f"the {len(data)} bytes end too early or are not such a message"
        raise DecodeError(name, message, offset=offset) from error

    def short(claimed: int, size: int, offset: int) -> NoReturn:
        message = f"{claimed} elements or bytes are claimed; the message has {size} bytes"
        raise DecodeError(name, message, offset=offset)

    def left_over(size: int, offset: int) -> NoReturn:
        message = f"{size - offset} of its {size} bytes are left over: the definition does not match the message"
        raise DecodeError(name, message, offset=offset)

    return {"fail": fail, "short": short, "left_over": left_over}


class _CodeWriter:
    """Collects the lines of one function and tracks what is known of the read position.

    The position is `o + ahead`; counted from the start, it is `residue` modulo `modulus`.
    """

    def __init__(self, wire: Wire, reads: NumberReader) -> None:
        self.lines: list[str] = []
        self.namespace: dict[str, Any] = {}
        self._constants: dict[tuple[str, object], str] = {}
        self._wire = wire
        self._reads = reads
        self._indent = 2
        self._ahead = 0
        self._modulus = 8
        self._residue = 0
        self._run: list[str] = []
        self._format = ""
        self._run_at = 0
        self._names = 0

    def line(self, text: str) -> None:
        self.lines.append("    " * self._indent + text)

    def constant(self, kind: str, value: object) -> str:
        """Return the name under which the function finds an object."""
        key = (kind, id(value) if kind == "c" else value)
        if key not in self._constants:
            name = f"{kind}{len(self._constants)}"
            self._constants[key] = name
            self.namespace[name] = struct.Struct(str(value)).unpack_from if kind == "u" else value
        return self._constants[key]

    def struct(self, kind: Struct) -> str:
        """Read a type's fields into a new object; returns its name."""
        name = self._name("v")
        self.line(f"{name} = {self.constant('c', value_class(kind))}()")
        for field in kind.fields:
            self._read(field.type, f"{name}.{field.name}")
        if not kind.fields:
            self._ahead += self._wire.empty_size
            self._residue += self._wire.empty_size
        return name

    def flush(self) -> None:
        """Write the run of numbers that has been collected."""
        if self._run:
            unpack = self.constant("u", self._wire.order + self._format)
            self.line(f"{', '.join(self._run)}, = {unpack}(data, {self._position(self._run_at)})")
        self._run, self._format = [], ""

    def check_end(self) -> None:
        """Refuse a message with bytes behind its last field: it has another definition."""
        end = self._position(self._ahead)
        self.line(f"if size > {self._position(self._ahead + self._wire.padding)}: left_over(size, {end})")

    def _read(self, kind: Type, target: str) -> None:
        if isinstance(kind, Struct):
            self.line(f"{target} = {self.struct(kind)}")
        elif isinstance(kind, Array):
            self._array(kind, target)
        elif kind.code:
            self._number(kind, target)
        else:
            self._text(kind, target)

    def _name(self, prefix: str) -> str:
        self._names += 1
        return f"{prefix}{self._names - 1}"

    def _position(self, ahead: int) -> str:
        return f"o + {ahead}" if ahead else "o"

    def _align(self, size: int) -> None:
        """Move to the next position where a number of `size` bytes may stand."""
        size = min(size, self._wire.alignment)
        if size <= self._modulus:
            step = -self._residue % size
            self._ahead += step
            self._residue += step
            return
        self.flush()
        self._advance_to(1)
        origin = self._wire.start % size
        self.line(f"o = (o + {size - 1 - origin} & -{size}) + {origin}" if origin else f"o = o + {size - 1} & -{size}")
        self._modulus, self._residue = size, 0

    def _advance_to(self, modulus: int) -> None:
        """Bring `o` to the position; `modulus` is what is known of it from now on."""
        self.flush()
        if self._ahead:
            self.line(f"o += {self._ahead}")
        self._ahead, self._modulus, self._residue = 0, modulus, 0

    def _number(self, kind: Primitive, target: str) -> None:
        self._align(kind.size)
        if not self._run:
            self._run_at = self._ahead
        else:
            gap = self._ahead - self._run_at - struct.calcsize(self._wire.order + self._format)
            self._format += f"{gap}x" if gap else ""
        self._run.append(target)
        self._format += kind.code
        self._ahead += kind.size
        self._residue += kind.size

    def _count(self) -> str:
        """Read a length of 4 bytes, and continue behind it; returns its name."""
        name = self._name("n")
        self._number(_COUNT, name)
        self._advance_to(min(4, self._wire.alignment))
        return name

    def _text(self, kind: Primitive, target: str) -> None:
        count = self._count()
        if kind.name == "wstring":
            self.line(f"{target}, o = read_wide(data, o, {count}, {self._wire.order == '<'})")
        else:
            end = self._name("e")
            self.line(f"{end} = o + {count}")
            self.line(f"if {end} > size: short({count}, size, o)")
            closing = " - 1" if self._wire.counts_nul else ""
            self.line(f"{target} = str(data[o:{end}{closing}], 'utf-8', 'replace')")
            self.line(f"o = {end}")
        self._modulus, self._residue = 1, 0

    def _array(self, kind: Array, target: str) -> None:
        if is_numbers(kind) and isinstance(kind.element, Primitive):
            self._numbers(kind.element, kind.length, target)
            return
        if self._wire.has_lengths:
            self._number(_COUNT, self._name("skipped"))
        if kind.length is None:
            count = self._count()
        else:
            self._advance_to(1)
            count = str(kind.length)
        minimum, objects = min_size(kind.element, self._wire), 1 + object_count(kind.element)
        self.line(f"left -= {count} * {objects}")
        self.line(f"if left < 0 or {count} * {minimum} > size - o: short({count}, size, o)")
        elements, part = self._name("a"), self._name("p")
        self.line(f"{elements} = []")
        self.line(f"for {self._name('i')} in range({count}):")
        self._indent += 1
        self._modulus, self._residue = 1, 0
        if isinstance(kind.element, Struct):
            part = self.struct(kind.element)
        else:
            self._read(kind.element, part)
        self._advance_to(1)
        self.line(f"{elements}.append({part})")
        self._indent -= 1
        self.line(f"{target} = {elements}")

    def _numbers(self, kind: Primitive, length: int | None, target: str) -> None:
        take = "flags" if kind.code == "?" else "numbers"
        form = self.constant("d", self._reads.form(kind))
        if length is not None:
            if length:
                self._align(kind.size)
            value = f"{take}(data, {form}, {length}, {self._position(self._ahead)})" if length else f"nothing({form})"
            self.line(f"{target} = {value}")
            self._ahead += length * kind.size
            self._residue += length * kind.size
            return
        count = self._count()
        size = min(kind.size, self._wire.alignment)
        if size > self._modulus:
            origin = self._wire.start % size
            self.line(f"if {count}: o = (o + {size - 1 - origin} & -{size}) + {origin}")
        self.line(f"{target} = {take}(data, {form}, {count}, o) if {count} else nothing({form})")
        self.line(f"o += {count} * {kind.size}" if kind.size > 1 else f"o += {count}")
        self._modulus, self._residue = min(size, self._modulus), 0
