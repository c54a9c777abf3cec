"""Parses ROS message definitions, and finds those of common types that recordings lack.

Reads ROS 1 (a bag's `message_definition`, MCAP's "ros1msg") and ROS 2 ("ros2msg").

The text is untrusted: it is read line by line with linear patterns, and only checked names and numbers leave the
parser. Default values and bounds do not affect the bytes and are ignored.

`well_known.txt` has the types of common_interfaces and the core packages, for rosbag2 databases without definitions. A
recording's own definition always wins. Few types changed between releases: the definition of Humble is the default, and
that of another release is used where the default does not fit a message.

Source: wiki.ros.org/msg; "Interface definition" of the ROS 2 documentation; MCAP's well-known schema encodings.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import Enum
from functools import lru_cache
from importlib.resources import files
from typing import NamedTuple

from kleinkram.recordings.decoding import types
from kleinkram.recordings.decoding.types import PRIMITIVES, Definition, FieldText, Primitive, SchemaError


class Ros(Enum):
    """Which ROS a definition is written for: `byte`, `char`, `time` and `Header` mean different things."""

    one = 1
    two = 2


_RULE = re.compile(r"={3,}\s*\Z")
_LINE = re.compile(
    r"(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=\d{1,18})?(?P<array>\[(?:<=)?\d{0,18}\])?"
    r"[ \t]+(?P<name>[A-Za-z_][A-Za-z0-9_]*)[ \t]*(?P<rest>.*)\Z"
)
# The types that a text may use without defining them.
_BUILT_IN = {
    Ros.one: {
        "time": "uint32 secs\nuint32 nsecs",
        "duration": "int32 secs\nint32 nsecs",
        "std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id",
    },
    Ros.two: {
        "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
        "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec",
        "service_msgs/msg/ServiceEventInfo": (
            "uint8 event_type\nbuiltin_interfaces/msg/Time stamp\nchar[16] client_gid\nint64 sequence_number"
        ),
        "std_msgs/msg/Header": "builtin_interfaces/msg/Time stamp\nstring frame_id",
    },
}
_OTHER_NAMES = {
    Ros.one: {"byte": PRIMITIVES["int8"], "char": PRIMITIVES["uint8"]},
    Ros.two: {"byte": PRIMITIVES["uint8"], "char": PRIMITIVES["uint8"]},
}


def parse_msg(name: str, text: str, ros: Ros) -> types.Struct:
    """Return the type `name` that a text of definitions describes.

    A service's text, which has "---" between request and response, gives `..._Request`, `..._Response` and the
    `..._Event` that ROS 2 records.
    """
    definitions = {known: _definition(known, built_in) for known, built_in in _BUILT_IN[ros].items()}
    definitions |= _split(name, text)
    by_short_name: dict[str, Definition] = {}
    for known, definition in definitions.items():
        if "/msg/" in known or short_name(known) not in by_short_name:
            by_short_name[short_name(known)] = definition
    primitives = {**PRIMITIVES, **_OTHER_NAMES[ros]}
    if ros is Ros.one:
        del primitives["wstring"]

    def find(type_name: str, owner: str) -> Primitive | Definition | None:
        if type_name in primitives:
            return primitives[type_name]
        for candidate in _candidates(type_name, owner, ros):
            definition = definitions.get(candidate) or by_short_name.get(short_name(candidate))
            if definition is not None:
                return definition
        return None

    root = definitions.get(name) or by_short_name.get(short_name(name))
    if root is None:
        raise SchemaError(f"the schema's text does not define {name}")
    return types.resolve(root, find)


def _candidates(type_name: str, owner: str, ros: Ros) -> tuple[str, ...]:
    """Return the full names that a type name in a definition of `owner` can stand for, the first choice first."""
    if "/" in type_name:
        return (type_name,)
    own = f"{owner.partition('/')[0]}/{type_name}"
    if type_name != "Header":
        return (own, type_name)
    return ("std_msgs/Header", own) if ros is Ros.one else (own, "std_msgs/Header")


def short_name(name: str) -> str:
    """Return the name of a type without what kind of interface it is: "a/msg/B" -> "a/B"."""
    package, _, rest = name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}" if rest else name


def split_blocks(text: str, mark: str) -> list[tuple[str | None, str]]:
    """Cut a schema at its lines of "=": (name behind "MSG:" or "IDL:", or None for the first; text)."""
    blocks: list[tuple[str | None, list[str]]] = [(None, [])]
    is_head = False
    for line in text.split("\n"):
        stripped = line.strip()
        if _RULE.match(stripped):
            is_head = True
        elif is_head and stripped.startswith(mark):
            blocks.append((stripped.removeprefix(mark).strip(), []))
            is_head = False
        else:
            is_head = is_head and not stripped
            blocks[-1][1].append(line)
        if len(blocks) > types.MAX_TYPES:
            raise SchemaError(f"more than {types.MAX_TYPES} types")
    return [(name, "\n".join(lines)) for name, lines in blocks]


def _split(root: str, text: str) -> dict[str, Definition]:
    definitions: dict[str, Definition] = {}
    for name, block in split_blocks(text, "MSG:"):
        if name is None:
            sections = re.split(r"^---[ \t]*$", block, flags=re.MULTILINE)
            if len(sections) == 2:
                definitions.update(_service(root, sections))
            elif len(sections) == 1:
                definitions[root] = _definition(root, block)
            else:
                raise SchemaError("definitions of actions are not read")
        else:
            definitions.setdefault(name, _definition(name, block))
    return definitions


def _service(root: str, sections: list[str]) -> dict[str, Definition]:
    base = re.sub(r"_(Event|Request|Response)\Z", "", root)
    request, response = f"{base}_Request", f"{base}_Response"
    event = (
        FieldText("info", "service_msgs/msg/ServiceEventInfo", ()),
        FieldText("request", request, (None,)),
        FieldText("response", response, (None,)),
    )
    return {
        request: _definition(request, sections[0]),
        response: _definition(response, sections[1]),
        f"{base}_Event": Definition(f"{base}_Event", event),
    }


class Line(NamedTuple):
    """A field or constant as written. `array`: such as "[3]"; `value`: of a constant, None for a field."""

    type_name: str
    array: str
    name: str
    value: str | None


def read_lines(name: str, text: str) -> Iterator[Line]:
    """Yield the fields and constants of the definition of one type."""
    for line in text.split("\n"):
        stripped = line.strip()
        if not stripped or stripped.startswith("#"):
            continue
        match = _LINE.match(stripped)
        if match is None:
            raise SchemaError(f"the line '{stripped[:100]}' of {name} is no field")
        is_constant = match["rest"].startswith("=")
        value = match["rest"][1:].strip() if is_constant else None
        yield Line(match["type"], match["array"] or "", match["name"], value)


def _definition(name: str, text: str) -> Definition:
    fields: list[FieldText] = []
    constants: dict[str, types.ConstantValue] = {}
    for line in read_lines(name, text):
        if line.value is not None:
            value = constant_value(line.type_name, line.value)
            if value is not None:
                constants[line.name] = value
            continue
        number = line.array.strip("[]")
        is_fixed = number and not number.startswith("<=")
        lengths: tuple[int | None, ...] = () if not line.array else (int(number) if is_fixed else None,)
        fields.append(FieldText(line.name, line.type_name, lengths))
    return Definition(name, tuple(fields), types.constants_of(constants))


def constant_value(type_name: str, text: str) -> types.ConstantValue | None:
    """Return a constant's value; None for what is not written as its type."""
    if type_name in ("string", "wstring"):
        quoted = len(text) > 1 and text[0] in "\"'" and text[-1] == text[0]
        return text[1:-1] if quoted else text
    text = text.partition("#")[0].strip()[:80]
    try:
        if type_name == "bool":
            return text.lower() in ("true", "1")
        return float(text) if type_name.startswith("float") else int(text, 0)
    except ValueError:
        return None


@lru_cache(maxsize=1)
def known_definitions() -> dict[str, list[str]]:
    """Return the definitions by short names ("sensor_msgs/Imu"): the default first, then those of other releases."""
    text = (files("kleinkram.recordings.decoding") / "well_known.txt").read_text("utf-8")
    definitions: dict[str, list[str]] = {}
    for line in text.splitlines():
        name, mark, definition = line.partition(":")
        if mark and not line.startswith("#"):
            definitions.setdefault(name, []).append(definition.strip().replace("; ", "\n"))
    return definitions


def well_known_definitions(name: str) -> list[str]:
    """Return the texts that may define a ROS 2 type ("sensor_msgs/msg/Imu"), the default first; none for other types.

    Each text has all types behind it that the type needs; each but the first takes one type from another release.
    """
    known = known_definitions()
    root = short_name(name)
    if root not in known or (name.count("/") > 1 and "/msg/" not in name):
        return []
    needed = [root]
    for needed_name in needed:  # which grows by all that any definition mentions
        package = needed_name.partition("/")[0]
        lines = [line for definition in known[needed_name] for line in definition.splitlines()]
        for kind in (line.partition(" ")[0].partition("[")[0] for line in lines):
            full = kind if "/" in kind else f"{package}/{kind}"
            if full in known and full not in needed:
                needed.append(full)
    default = {needed_name: known[needed_name][0] for needed_name in needed}
    others = [{**default, changed: other} for changed in needed for other in known[changed][1:]]
    return [
        "\n".join([texts.pop(root) or "# no fields", *(f"===\nMSG: {one}\n{text}" for one, text in texts.items())])
        for texts in (default, *others)
    ]
