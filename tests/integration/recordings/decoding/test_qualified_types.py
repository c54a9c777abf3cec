"""Packages whose types share base names: every field has the type of its definition."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kleinkram.recordings.decoding import DecodeError, Decoder, decoder_for, to_arrow, to_plain

MakeCase = Callable[[str], Path]
RULE = "=" * 80
LITTLE = b"\x00\x01\x00\x00"
PACKAGES = ("a_msgs", "b_msgs", "geometry_msgs2")
NAMES = ("Pose", "Path", "Point", "Header2")
NUMBERS = ("float64", "uint8", "int16", "float32", "int64")


@dataclass(frozen=True)
class Generated:
    """Definitions of all packages: fields as (written type, full type or None for a number, name)."""

    fields: dict[str, list[tuple[str, str | None, str]]]
    text: str


def generated(seed: int, root: str = "a_msgs/msg/Root") -> Generated:
    """Types in an order in which each mentions only earlier ones, by its base name, "pkg/Type" or "pkg/msg/Type"."""
    chosen = random.Random(seed)  # a test needs the same numbers each time
    order = [f"{package}/msg/{name}" for package in PACKAGES for name in NAMES]
    chosen.shuffle(order)
    fields: dict[str, list[tuple[str, str | None, str]]] = {}
    for full in [*order, root]:
        package = full.partition("/")[0]
        own: list[tuple[str, str | None, str]] = []
        for place in range(chosen.randint(1, 4)):
            known = list(fields)
            if known and chosen.random() < (1 if full == root else 0.5):
                target = chosen.choice(known[-6:])
                ways = [target, target.replace("/msg/", "/")]
                ways += [target.rpartition("/")[2]] if target.startswith(f"{package}/") else []
                own.append((chosen.choice(ways), target, f"f{place}"))
            else:
                own.append((chosen.choice(NUMBERS), None, f"f{place}"))
        fields[full] = own
    blocks = ["\n".join(f"{kind} {name}" for kind, _, name in fields[root])]
    others = list(order)
    chosen.shuffle(others)
    for full in others:
        head = chosen.choice((full, full.replace("/msg/", "/")))
        blocks.append(f"MSG: {head}\n" + "\n".join(f"{kind} {name}" for kind, _, name in fields[full]))
    return Generated(fields, f"\n{RULE}\n".join(blocks) + "\n")


def message(store: Any, made: Generated, full: str, counter: list[int]) -> Any:
    """An object of rosbags whose numbers are 1, 2, 3 ... in the order of the fields."""
    values: dict[str, Any] = {}
    for kind, target, name in made.fields[full]:
        if target is not None:
            values[name] = message(store, made, target, counter)
        else:
            counter[0] = counter[0] % 100 + 1
            values[name] = float(counter[0]) if kind.startswith("float") else counter[0]
    return store.types[full](**values)


def as_dict(value: Any) -> Any:
    if hasattr(value, "__slots__") and not isinstance(value, np.generic):
        names = [name for name in value.__slots__ if name != "__msgtype__"]
        return {name: as_dict(getattr(value, name)) for name in names}
    if hasattr(value, "__dict__") and not isinstance(value, (int, float, np.generic)):
        return {name: as_dict(part) for name, part in vars(value).items() if not name.startswith("_")}
    return value


@pytest.mark.parametrize("seed", range(16))
def test_decodes_generated_types_as_rosbags_and_mcap_ros2_do(seed: int) -> None:
    made = generated(seed)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(made.text, "a_msgs/msg/Root"))
    theirs = message(store, made, "a_msgs/msg/Root", [0])
    cdr = bytes(store.serialize_cdr(theirs, "a_msgs/msg/Root"))
    expected = as_dict(store.deserialize_cdr(cdr, "a_msgs/msg/Root"))
    ros2 = decoder_for("cdr", "a_msgs/msg/Root", "ros2msg", made.text.encode())
    assert isinstance(ros2, Decoder), ros2
    assert to_plain(ros2.decode(cdr)) == expected
    short = made.text.replace("/msg/", "/")  # mcap_ros2 refuses "pkg/msg/Type" as a field's type
    assert as_dict(generate_dynamic("a_msgs/Root", short)["a_msgs/Root"](cdr)) == expected
    ros1 = decoder_for("ros1", "a_msgs/Root", "ros1msg", short.encode())
    assert isinstance(ros1, Decoder), ros1
    assert to_plain(ros1.decode(bytes(store.serialize_ros1(theirs, "a_msgs/msg/Root")))) == expected


def test_a_field_of_another_packages_type_of_the_same_name(make_case: MakeCase) -> None:
    printed = (make_case("18A") / "printed.txt").read_text()
    position, orientation = "Point(x=1.0, y=2.0, z=3.0)", "Quaternion(x=4.0, y=5.0, z=6.0, w=7.0)"
    for line in printed.splitlines():
        assert f"position=geometry_msgs/{position}, orientation=geometry_msgs/{orientation}" in line
        assert "own=my_msgs/Pose(x=8.0, y=9.0, theta=10.0)" in line
    assert len(printed.splitlines()) == 2


@pytest.mark.parametrize("field", ["nav_msgs/Path", "nav_msgs/msg/Path"])
def test_type_may_contain_a_type_of_the_same_base_name(field: str) -> None:
    text = f"{field} path\nuint8 n\n{RULE}\nMSG: nav_msgs/Path\nfloat64 x\n"
    ros2 = decoder_for("cdr", "my_msgs/msg/Path", "ros2msg", text.encode())
    assert isinstance(ros2, Decoder), ros2
    assert to_plain(ros2.decode(LITTLE + struct.pack("<dB", 1.5, 7))) == {"path": {"x": 1.5}, "n": 7}
    ros1 = decoder_for("ros1", "my_msgs/Path", "ros1msg", text.encode())
    assert isinstance(ros1, Decoder), ros1
    assert to_plain(ros1.decode(struct.pack("<dB", 1.5, 7))) == {"path": {"x": 1.5}, "n": 7}


def test_header_of_the_own_package_is_used_in_ros2_only() -> None:
    text = f"Header h\n{RULE}\nMSG: my_msgs/Header\nuint8 a\n"
    ros2 = decoder_for("cdr", "my_msgs/msg/T", "ros2msg", text.encode())
    assert isinstance(ros2, Decoder)
    assert to_plain(ros2.decode(LITTLE + b"\x05")) == {"h": {"a": 5}}
    ros1 = decoder_for("ros1", "my_msgs/T", "ros1msg", text.encode())
    assert isinstance(ros1, Decoder)
    header = {"seq": 1, "stamp": {"secs": 2, "nsecs": 3}, "frame_id": ""}
    assert to_plain(ros1.decode(struct.pack("<IIII", 1, 2, 3, 0))) == {"h": header}


def test_idl_names_resolve_from_the_innermost_module() -> None:
    text = """
    typedef double Pose;
    module a { module msg { struct Pose { long x; }; }; };
    module b { module msg {
      struct Pose { double theta; };
      struct Both { a::msg::Pose real; Pose own; ::Pose plain; };
    }; };
    """
    decoder = decoder_for("cdr", "b/msg/Both", "ros2idl", text.encode())
    assert isinstance(decoder, Decoder), decoder
    value = to_plain(decoder.decode(LITTLE + struct.pack("<i4xdd", 1, 2.0, 3.0)))
    assert value == {"real": {"x": 1}, "own": {"theta": 2.0}, "plain": 3.0}


@pytest.mark.parametrize(
    ("encodings", "header", "padding"),
    [(("ros1", "ros1msg"), b"", 0), (("cdr", "ros2msg"), LITTLE, 3), (("cdr", "ros2idl"), LITTLE, 3)],
)
@pytest.mark.parametrize("is_array", [False, True])
def test_trailing_bytes_are_an_error_but_padding_is_not(
    encodings: tuple[str, str], header: bytes, padding: int, is_array: bool
) -> None:
    text = "uint32[] a" if is_array else "uint32 a"
    if encodings[1] == "ros2idl":
        kind = "sequence<unsigned long>" if is_array else "unsigned long"
        text = f"module a {{ module msg {{ struct T {{ {kind} a; }}; }}; }};"
    decoder = decoder_for(encodings[0], "a/msg/T", encodings[1], text.encode())
    assert isinstance(decoder, Decoder), decoder
    data = header + (struct.pack("<II", 1, 7) if is_array else struct.pack("<I", 7))
    good = [data + bytes(extra) for extra in range(padding + 1)]
    for raw in good:
        assert to_plain(decoder.decode(raw)) == {"a": [7] if is_array else 7}
    with pytest.raises(DecodeError, match=rf"{padding + 1} of its {len(data) + padding + 1} bytes are left over"):
        decoder.decode(data + bytes(padding + 1))
    noticed: list[str] = []
    bad = [data + bytes(padding + 5)] * 40
    messages = [(time, time, raw) for time, raw in enumerate([*good * 20, *bad])]
    table = to_arrow(decoder, messages, notice=lambda _, error: noticed.append(str(error)))
    assert table["a"].null_count == len(noticed) == 40
    assert "left over" in noticed[0]
