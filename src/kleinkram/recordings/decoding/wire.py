"""How values lie in bytes: ROS 1's serialisation, and CDR in its plain forms.

Source: wiki.ros.org/ROS/Technical Overview (little-endian, nothing aligned, lengths of 4 bytes); OMG DDS-XTypes 1.3
section 7.4 (encapsulation header of 4 bytes, alignment counted from behind it; XCDR2 aligns to at most 4 and puts a
length in front of arrays of anything but numbers); rosidl (a type without fields holds one byte in CDR).
"""

from __future__ import annotations

from dataclasses import dataclass

from kleinkram.recordings.decoding.schema import Array, Primitive, Struct, Type


@dataclass(frozen=True)
class Wire:
    """One way of laying out values.

    Attributes:
        order: "<" or ">", as in `struct`.
        start: the byte of a message at which its first field begins, from which alignment counts.
        alignment: the most that a number is aligned to; 1 if nothing is.
        counts_nul: the length of a text counts a closing zero byte.
        empty_size: bytes of a type without fields.
        has_lengths: arrays of anything but numbers have their length in bytes in front.
        padding: the most bytes that may follow the last field.
    """

    order: str
    start: int
    alignment: int
    counts_nul: bool
    empty_size: int
    has_lengths: bool
    padding: int


ROS1 = Wire("<", 0, 1, counts_nul=False, empty_size=0, has_lengths=False, padding=0)
CDR_BE = Wire(">", 4, 8, counts_nul=True, empty_size=1, has_lengths=False, padding=3)
CDR_LE = Wire("<", 4, 8, counts_nul=True, empty_size=1, has_lengths=False, padding=3)
CDR2_BE = Wire(">", 4, 4, counts_nul=True, empty_size=1, has_lengths=True, padding=3)
CDR2_LE = Wire("<", 4, 4, counts_nul=True, empty_size=1, has_lengths=True, padding=3)

ENCAPSULATIONS = {0: CDR_BE, 1: CDR_LE, 6: CDR2_BE, 7: CDR2_LE}
"""By the second byte of a CDR message; the first is 0."""

OTHER_ENCAPSULATIONS = {
    2: "PL_CDR (big-endian)",
    3: "PL_CDR (little-endian)",
    8: "D_CDR2 (big-endian)",
    9: "D_CDR2 (little-endian)",
    10: "PL_CDR2 (big-endian)",
    11: "PL_CDR2 (little-endian)",
}
"""Known, and not read: their layout depends on the extensibility of types, which ROS schemas do not tell."""


def least_size(kind: Type, wire: Wire) -> int:
    """Return the fewest bytes that a value can take, without alignment: what bounds how many there can be."""
    if isinstance(kind, Primitive):
        return kind.size or 4
    if isinstance(kind, Array):
        return 4 if kind.length is None else kind.length * least_size(kind.element, wire)
    return sum(least_size(field.type, wire) for field in kind.fields) if kind.fields else wire.empty_size


def object_count(kind: Type) -> int:
    """Return how many objects a value of a type is made of, without what the message itself counts."""
    if isinstance(kind, Struct):
        return 1 + sum(object_count(field.type) for field in kind.fields)
    if isinstance(kind, Array):
        inside = 0 if kind.length is None else kind.length * object_count(kind.element)
        return 1 + (0 if is_numbers(kind) else inside)
    return 0


def is_numbers(kind: Array) -> bool:
    """Say whether an array is one of numbers or truth values."""
    return isinstance(kind.element, Primitive) and bool(kind.element.code)
