"""Finds the type of the other version of ROS, ROS 1 or ROS 2, that a message type corresponds to.

A type that both versions have gets the definition that the other version has: a header without or with its sequence
number, names of fields in lower case, constants of another type. Any other type keeps its own definition, with names
that the other version allows. A type that has a well-known name and other fields than the well-known type does not
correspond to it: nodes of the other version would misread its messages.

Source: wiki.ros.org/msg and genmsg (md5 sums); "Interface definition" of the ROS 2 documentation (names);
common_interfaces and common_msgs (definitions).
"""

from __future__ import annotations

import hashlib
import keyword
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

from kleinkram.recordings.decoding.idl_definitions import parse_idl
from kleinkram.recordings.decoding.msg_definitions import (
    Line,
    Ros,
    constant_value,
    known_definitions,
    parse_msg,
    read_lines,
    short_name,
    split_blocks,
    well_known_definitions,
)
from kleinkram.recordings.decoding.transcode import Transcode, check_pair, legal_name, transcoder
from kleinkram.recordings.decoding.types import MAX_SCHEMA_BYTES, Array, Primitive, SchemaError, Struct, Type
from kleinkram.recordings.decoding.wire import CDR_LE, ROS1

_RULE = "=" * 80
_NO_FIELDS = "# no fields"  # an empty definition would pass for a missing one
_TYPE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*\Z")
_PACKAGE_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")
_ROS1_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*\Z")
_CONSTANT_NAME = re.compile(r"[A-Z](?:_?[A-Z0-9]+)*\Z")
_RENAMED = {"tf/tfMessage": "tf2_msgs/TFMessage", "roslib/Header": "std_msgs/Header"}
_ROS2_TIMES = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}
_ROS1_TIMES = {name: word for word, name in _ROS2_TIMES.items()}
_ALIASES = frozenset(("byte", "char"))
_UNSIGNED = {"byte": "uint8"}  # which is signed in ROS 1; types that both versions have keep their md5 sum

ROS1_TEXTS = {
    "std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id",
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] D\nfloat64[9] K\n"
        "float64[9] R\nfloat64[12] P\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    ),
    "shape_msgs/SolidPrimitive": (
        "uint8 BOX=1\nuint8 SPHERE=2\nuint8 CYLINDER=3\nuint8 CONE=4\nuint8 type\nfloat64[] dimensions\nuint8 BOX_X=0\n"
        "uint8 BOX_Y=1\nuint8 BOX_Z=2\nuint8 SPHERE_RADIUS=0\nuint8 CYLINDER_HEIGHT=0\nuint8 CYLINDER_RADIUS=1\n"
        "uint8 CONE_HEIGHT=0\nuint8 CONE_RADIUS=1"
    ),
    "stereo_msgs/DisparityImage": (
        "std_msgs/Header header\nsensor_msgs/Image image\nfloat32 f\nfloat32 T\n"
        "sensor_msgs/RegionOfInterest valid_window\nfloat32 min_disparity\nfloat32 max_disparity\nfloat32 delta_d"
    ),
    "visualization_msgs/ImageMarker": (
        "uint8 CIRCLE=0\nuint8 LINE_STRIP=1\nuint8 LINE_LIST=2\nuint8 POLYGON=3\nuint8 POINTS=4\nuint8 ADD=0\n"
        "uint8 REMOVE=1\nstd_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Point position\nfloat32 scale\nstd_msgs/ColorRGBA outline_color\nuint8 filled\n"
        "std_msgs/ColorRGBA fill_color\nduration lifetime\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] outline_colors"
    ),
    "visualization_msgs/Marker": (
        "uint8 ARROW=0\nuint8 CUBE=1\nuint8 SPHERE=2\nuint8 CYLINDER=3\nuint8 LINE_STRIP=4\nuint8 LINE_LIST=5\n"
        "uint8 CUBE_LIST=6\nuint8 SPHERE_LIST=7\nuint8 POINTS=8\nuint8 TEXT_VIEW_FACING=9\nuint8 MESH_RESOURCE=10\n"
        "uint8 TRIANGLE_LIST=11\nuint8 ADD=0\nuint8 MODIFY=0\nuint8 DELETE=2\nuint8 DELETEALL=3\n"
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
        "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nduration lifetime\nbool frame_locked\n"
        "geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring text\nstring mesh_resource\n"
        "bool mesh_use_embedded_materials"
    ),
}
"""Types of ROS 1 (Noetic) that differ from those of ROS 2 by more than the names of times."""


@dataclass(frozen=True)
class ReEncoding:
    """How messages of a type become those of the other version.

    Attributes:
        name: of the type in the other version, such as "sensor_msgs/msg/Imu" or "sensor_msgs/Imu".
        definition: with all types that it needs.
        md5sum: of a ROS 1 type; empty for ROS 2.
        transcode: takes the bytes of a message; raises `DecodeError` and nothing else.
    """

    name: str
    definition: str
    md5sum: str
    transcode: Transcode


@lru_cache(maxsize=512)
def to_ros2(name: str, definition: bytes) -> ReEncoding:
    """Return how messages of a ROS 1 type become CDR. Cached.

    Raises:
        SchemaError: they cannot, with the reason.
    """
    text = _text_of(definition)
    source = parse_msg(name, text, Ros.one)
    types = _Ros2Types(_lines_by_type(name, text))
    root = types.add(source)
    ros2_name = root.replace("/", "/msg/")
    made = full_definition(root, types.texts)
    return ReEncoding(ros2_name, made, "", transcoder(source, parse_msg(ros2_name, made, Ros.two), ROS1, CDR_LE))


@lru_cache(maxsize=512)
def to_ros1(name: str, schema_encoding: str, definition: bytes) -> ReEncoding:
    """Return how CDR messages of a type become those of ROS 1. Cached.

    Raises:
        SchemaError: they cannot, with the reason.
    """
    text = _text_of(definition)
    lines: dict[str, list[Line]] = {}
    if schema_encoding in ("ros2idl", "omgidl"):
        source = parse_idl(name, text)
    elif schema_encoding == "ros2msg":
        source = parse_msg(name, text, Ros.two)
        lines = {kind: [*map(_as_ros1_constant, part)] for kind, part in _lines_by_type(name, text).items()}
    else:
        raise SchemaError("the recording has no definition of it, and it is not one of the common types")
    if short_name(source.name) in _ROS1_TIMES:
        raise SchemaError(f"ROS 1 has no message {short_name(source.name)}")
    types = _Ros1Types(lines, ROS1_TEXTS)
    root = types.add(source)
    made = full_definition(root, types.texts)
    transcode = transcoder(source, parse_msg(root, made, Ros.one), CDR_LE, ROS1)
    return ReEncoding(root, made, md5sum_of(root, types.texts), transcode)


def ros1_md5sum(name: str, definition: bytes) -> str:
    """Return the md5 sum of a ROS 1 type by its definition.

    Raises:
        SchemaError: the definition cannot be read.
    """
    text = _text_of(definition)
    types = _Ros1Types(_lines_by_type(name, text), {})
    return md5sum_of(types.add(parse_msg(name, text, Ros.one)), types.texts)


def _as_ros1_constant(line: Line) -> Line:
    """Return a constant of ROS 2 as ROS 1 writes it: texts without quotation marks, True and False; others as is."""
    if line.value is None or line.type_name not in ("string", "bool"):
        return line
    return line._replace(value=str(constant_value(line.type_name, line.value)))


def _text_of(definition: bytes) -> str:
    if len(definition) > MAX_SCHEMA_BYTES:
        raise SchemaError(f"its schema has {len(definition)} bytes; at most {MAX_SCHEMA_BYTES} are read")
    return definition.decode("utf-8", "replace")


def _lines_by_type(root: str, text: str) -> dict[str, list[Line]]:
    """Return fields and constants by the short names of types. A service's text, which has two parts, gives none."""
    blocks = ((name or root, block) for name, block in split_blocks(text, "MSG:"))
    return {
        short_name(name): [*read_lines(name, block)]
        for name, block in blocks
        if not re.search(r"^---[ \t]*$", block, re.MULTILINE)
    }


class _Types:
    """The types that one type needs in the other version: `texts` by short name."""

    def __init__(self, lines: Mapping[str, list[Line]]) -> None:
        self.texts: dict[str, str] = {}
        self._lines = lines
        self._names: dict[str, str] = {}

    def add(self, struct: Struct) -> str:
        """Add a type and all that it needs; returns its name in the other version."""
        if struct.name not in self._names:
            self._names[struct.name] = self._add(struct)
        return self._names[struct.name]

    def _add(self, struct: Struct) -> str:
        raise NotImplementedError

    def _set(self, name: str, text: str) -> None:
        if self.texts.setdefault(name, text) != text:
            raise SchemaError(f"two of its types become {name}")

    def _fields(self, struct: Struct) -> Iterator[tuple[str, str]]:
        """Yield type and name of each field, as the other version writes the type."""
        for field in struct.fields:
            is_changed = field.name.endswith("_") and keyword.iskeyword(field.name[:-1])
            yield self._type_text(field.type), field.name[:-1] if is_changed else field.name

    def _type_text(self, kind: Type) -> str:
        if isinstance(kind, Struct):
            return self.add(kind)
        if isinstance(kind, Primitive):
            return kind.name
        if isinstance(kind.element, Array):
            raise SchemaError("arrays of arrays are not part of message definitions")
        return f"{self._type_text(kind.element)}[{'' if kind.length is None else kind.length}]"

    def _own_lines(self, struct: Struct) -> list[Line]:
        return self._lines.get(short_name(struct.name), [])


class _Ros2Types(_Types):
    """Types of ROS 2 by those of ROS 1."""

    def _add(self, struct: Struct) -> str:
        name = _ROS2_TIMES.get(struct.name) or _ros2_name(struct.name)
        if name in known_definitions():
            self._add_well_known(name, struct)
            return name
        fields = [(kind, legal_name(field)) for kind, field in self._fields(struct)]
        for _, field in fields:
            if not field or not field[0].isalpha() or [other for _, other in fields].count(field) > 1:
                raise SchemaError(f"{struct.name} has two fields '{field}' in lower case, or one without a legal name")
        constants = dict(filter(None, map(_ros2_constant, self._own_lines(struct))))
        taken = {field for _, field in fields}
        lines = [text for constant, text in constants.items() if constant not in taken]
        self._set(name, "\n".join([*lines, *(f"{kind} {field}" for kind, field in fields)]))
        return name

    def _add_well_known(self, name: str, struct: Struct) -> None:
        """Add the first definition of a well-known type that the type corresponds to."""
        reasons: list[SchemaError] = []
        full_name = name.replace("/", "/msg/")
        for text in well_known_definitions(full_name):
            try:
                check_pair(struct, parse_msg(full_name, text, Ros.two))
            except SchemaError as error:
                reasons.append(error)
                continue
            for block_name, block in split_blocks(text, "MSG:"):
                self._set(block_name or name, block.strip())
            return
        raise SchemaError(f"it is not the {name} of ROS 2: {reasons[0]}")


def _ros2_name(name: str) -> str:
    name = short_name(name)
    if name in _RENAMED:
        return _RENAMED[name]
    package, _, base = name.rpartition("/")
    if not _TYPE_NAME.match(base):
        base = "".join(part[:1].upper() + part[1:] for part in base.split("_"))
    if not _PACKAGE_NAME.match(legal_name(package)) or not _TYPE_NAME.match(base):
        raise SchemaError(f"'{name[:100]}' is not a name that a type of ROS 2 can have")
    return f"{legal_name(package)}/{base}"


def _ros2_constant(line: Line) -> tuple[str, str] | None:
    """Return name and definition of a constant; None for a field, and for what ROS 2 cannot express."""
    name = line.name.upper()
    if line.value is None or line.array or not _CONSTANT_NAME.match(name):
        return None
    if line.type_name == "string":
        mark = next((mark for mark in "\"'" if mark not in line.value and "\\" not in line.value), None)
        return None if mark is None else (name, f"string {name}={mark}{line.value}{mark}")
    value = constant_value(line.type_name, line.value)
    text = str(value).lower() if isinstance(value, bool) else str(value)
    kind = {"byte": "int8", "char": "uint8"}.get(line.type_name, line.type_name)
    return None if value is None else (name, f"{kind} {name}={text}")


class _Ros1Types(_Types):
    """Types of ROS 1 by those of ROS 2, or by themselves. `known`: definitions that ROS 1 has, by name."""

    def __init__(self, lines: Mapping[str, list[Line]], known: Mapping[str, str]) -> None:
        super().__init__(lines)
        self._known = known

    def _add(self, struct: Struct) -> str:
        name = short_name(struct.name)
        if name in _ROS1_TIMES or name in _ROS2_TIMES:
            return _ROS1_TIMES.get(name, name)
        if not _ROS1_NAME.match(name):
            raise SchemaError(f"'{name[:100]}' is not a name that a type of ROS 1 can have")
        fields = [*self._fields(struct)]
        own = self._known.get(name)
        names = [legal_name(line.name) for line in read_lines(name, own or "") if line.value is None]
        if own is not None and names[-len(fields) :] == [legal_name(field) for _, field in fields]:
            self._set(name, own)
            return name
        lines = self._own_lines(struct)
        if self._known and name not in known_definitions():
            lines = [line._replace(type_name=_UNSIGNED.get(line.type_name, line.type_name)) for line in lines]
        aliases = {line.name: line.type_name for line in lines if line.type_name in _ALIASES}
        fields = [
            (aliases[field] + "".join(kind.partition("[")[1:]) if field in aliases else kind, field)
            for kind, field in fields
        ]
        constants = [f"{line.type_name} {line.name}={_ros1_value(line)}" for line in lines if line.value is not None]
        self._set(name, "\n".join([*constants, *(f"{kind} {field}" for kind, field in fields)]))
        return name


def _ros1_value(line: Line) -> str:
    """Return the value of a constant; only texts may have a number sign in them, others have a comment behind it."""
    value = line.value or ""
    return value if line.type_name == "string" else value.partition("#")[0].strip()


def full_definition(root: str, texts: Mapping[str, str]) -> str:
    """Return the definition of a type with all that it needs, as a bag and an MCAP have it; `texts` by short name."""
    needed = [root]
    for owner in needed:  # which grows
        nested_types = (_nested_type(line, owner) for line in texts[owner].split("\n"))
        needed += [nested for nested in dict.fromkeys(nested_types) if nested in texts and nested not in needed]
    definitions = [f"{_RULE}\nMSG: {nested}\n{texts[nested]}\n" for nested in needed[1:]]
    return "".join([f"{texts[root] or _NO_FIELDS}\n", *definitions])


def md5sum_of(root: str, texts: Mapping[str, str]) -> str:
    """Return the md5 sum by which ROS 1 identifies a type: constants first, nested types by their own sums."""
    lines = [line for line in texts[root].split("\n") if line]  # a text constant may hold other line separators
    parts = [line for line in lines if "=" in line]
    for line in lines:
        if "=" not in line:
            nested = _nested_type(line, root)
            parts.append(f"{md5sum_of(nested, texts)} {line.split()[1]}" if nested in texts else line)
    return hashlib.md5("\n".join(parts).encode(), usedforsecurity=False).hexdigest()


def _nested_type(line: str, owner: str) -> str:
    """Return the full name that the type of a field would have as a type of messages."""
    name = line.split()[0].partition("[")[0] if line.strip() else ""
    return name if "/" in name else f"{owner.partition('/')[0]}/{name}"
