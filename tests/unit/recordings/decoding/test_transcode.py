"""Messages re-encoded between ROS 1 and CDR have the same values, by `rosbags` and by our decoders."""

from __future__ import annotations

import hashlib
import random
import struct
from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kleinkram.recordings.decoding import DecodeError, Decoder, decoder_for, to_plain
from kleinkram.recordings.decoding.msg_definitions import Ros, known_definitions, parse_msg, well_known_definitions
from kleinkram.recordings.decoding.ros_versions import ros1_md5sum, to_ros1, to_ros2
from kleinkram.recordings.decoding.types import Array, SchemaError, Struct, Type
from tests.recording_files.plain_values import plain, rosbags_decoder

RULE = "=" * 80
NOETIC = get_typestore(Stores.ROS1_NOETIC)
PRIMITIVES = ("bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
STAMPS = ("time", "duration")


def generated_definition(seed: int) -> str:
    """Return types of two packages, each with fields of types before it; the last one is the root, `a_msgs/Root`."""
    chance = random.Random(seed)  # a test needs the same types each time
    known: list[str] = []
    blocks: list[str] = []
    for name in ("b_msgs/First", "a_msgs/Second", "b_msgs/Third", "a_msgs/Root"):
        lines = []
        for number in range(chance.randint(1, 6)):
            kinds = [chance.choice(PRIMITIVES), chance.choice(PRIMITIVES), "string", chance.choice(STAMPS)]
            kind = chance.choice([*kinds, "std_msgs/Header", *known])
            array = chance.choice(("", "", "[]", f"[{chance.randint(1, 4)}]"))
            lines.append(f"{kind}{array} f{number}")
        known.append(name)
        blocks.append("\n".join(lines))
    named = [f"MSG: {name}\n{block}" for name, block in zip(known[:-1], blocks[:-1], strict=True)]
    header = "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id"
    return f"\n{RULE}\n".join([blocks[-1], header, *named]) + "\n"


def random_ros1(kind: Type, chance: random.Random, *, longest: int = 4) -> bytes:
    """Return a value of a type, as ROS 1 serialises it; sequence numbers of headers are 0."""
    if isinstance(kind, Struct):
        if kind.name in STAMPS:
            return struct.pack("<II", chance.randrange(2**31), chance.randrange(10**9))
        parts = (
            bytes(4) if kind.name == "std_msgs/Header" and field.name == "seq" else random_ros1(field.type, chance)
            for field in kind.fields
        )
        return b"".join(parts)
    if isinstance(kind, Array):
        count = chance.randint(0, longest) if kind.length is None else kind.length
        values = b"".join(random_ros1(kind.element, chance) for _ in range(count))
        return values if kind.length is not None else struct.pack("<I", count) + values
    if not kind.code:
        text = "".join(chance.choice("abcü✓") for _ in range(chance.randint(0, 9))).encode()
        return struct.pack("<I", len(text)) + text
    if kind.code == "?":
        return bytes([chance.randrange(2)])
    if kind.code == "b":
        return struct.pack("b", chance.randrange(128))  # `byte` is signed in ROS 1 only
    if kind.code in "fd":
        return struct.pack(f"<{kind.code}", chance.uniform(-1e6, 1e6))
    return chance.randbytes(kind.size)


def decoded(encoding: str, name: str, schema_encoding: str, definition: str, data: bytes) -> Any:
    decoder = decoder_for(encoding, name, schema_encoding, definition.encode())
    assert isinstance(decoder, Decoder), decoder
    return plain(to_plain(decoder.decode(data)))


def assert_same_values(name: str, text: str, store: Any, seed: int) -> None:
    """Assert that a random message has the same values in CDR, by two readers, and the same bytes back in ROS 1."""
    source = parse_msg(name, text, Ros.one)
    raw = random_ros1(source, random.Random(seed))
    there = to_ros2(name, text.encode())
    cdr = there.transcode(raw)
    full_name = name.replace("/", "/msg/")
    expected = plain(store.deserialize_ros1(raw, full_name))
    assert rosbags_decoder("cdr", there.name, there.definition)(cdr) == expected
    assert decoded("cdr", there.name, "ros2msg", there.definition, cdr) == expected
    back = to_ros1(there.name, "ros2msg", there.definition.encode())
    assert back.transcode(cdr) == raw
    assert to_ros2(back.name, back.definition.encode()).transcode(raw) == cdr


@pytest.mark.parametrize("seed", range(60))
def test_generated_types_keep_their_values_there_and_back(seed: int) -> None:
    text = generated_definition(seed)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(text.partition("MSG: std_msgs/Header")[0].rstrip("=\n"), "a_msgs/msg/Root"))
    others = [block.strip() for block in text.split(f"{RULE}\n")[2:]]
    for block in others:
        head, _, lines = block.partition("\n")
        store.register(get_types_from_msg(lines, head.removeprefix("MSG: ").replace("/", "/msg/")))
    for number in range(5):
        assert_same_values("a_msgs/Root", text, store, seed * 100 + number)


def well_known() -> list[str]:
    return sorted(NOETIC.fielddefs)


@pytest.mark.parametrize("name", [name for name in well_known() if not name.startswith("builtin_interfaces/")])
def test_types_of_noetic_keep_their_values_there_and_back(name: str) -> None:
    text, _ = NOETIC.generate_msgdef(name, ros_version=1)
    for seed in range(3):
        assert_same_values(name.replace("/msg/", "/"), text, NOETIC, seed)


@pytest.mark.parametrize("name", [n for n in well_known() if n.replace("/msg/", "/") in known_definitions()])
def test_md5_sums_are_those_of_noetic(name: str) -> None:
    if name.startswith("builtin_interfaces/"):
        with pytest.raises(SchemaError, match="ROS 1 has no message builtin_interfaces"):
            to_ros1(name, "ros2msg", well_known_definitions(name)[0].encode())
        return
    made = [to_ros1(name, "ros2msg", text.encode()).md5sum for text in well_known_definitions(name)]
    assert NOETIC.generate_msgdef(name, ros_version=1)[1] in made


def test_header_loses_its_sequence_number() -> None:
    text = "std_msgs/Header header\n"
    made = to_ros2("my_msgs/T", text.encode())
    raw = struct.pack("<IIII", 7, 1, 2, 3) + b"map"
    assert made.transcode(raw) == b"\0\1\0\0" + struct.pack("<III", 1, 2, 4) + b"map\0"
    assert to_ros1(made.name, "ros2msg", made.definition.encode()).transcode(made.transcode(raw)) == bytes(4) + raw[4:]


def test_elements_of_other_strides_are_copied_as_a_whole() -> None:
    """As the points of a Livox lidar: 19 bytes each in ROS 1, and 20 in CDR, but for the last one."""
    point = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 a\nuint8 b\nuint8 c\n"
    text = f"P[] points\n{RULE}\nMSG: my_msgs/P\n{point}"
    made = to_ros2("my_msgs/Cloud", text.encode())
    points = [struct.pack("<IfffBBB", number, 1.5, 2.5, number / 2, 1, 2, number) for number in range(5)]
    raw = struct.pack("<I", 5) + b"".join(points)
    cdr = b"\0\1\0\0" + struct.pack("<I", 5) + b"\0".join(points)
    assert made.transcode(raw) == cdr
    assert to_ros1(made.name, "ros2msg", made.definition.encode()).transcode(cdr) == raw


def test_truth_values_become_0_or_1() -> None:
    made = to_ros2("my_msgs/T", b"bool a\nbool[] b\nbool[2] c\n")
    raw = b"\x05" + struct.pack("<I", 3) + b"\x00\x80\x01" + b"\xff\x00"
    assert made.transcode(raw) == b"\0\1\0\0" + b"\x01\0\0\0" + struct.pack("<I", 3) + b"\x00\x01\x01" + b"\x01\x00"


@pytest.mark.parametrize(("kind", "raw"), [("time", (2**31, 0)), ("duration", (0, 2**32 - 1))])
def test_a_time_that_ros_2_cannot_express_is_refused(kind: str, raw: tuple[int, int]) -> None:
    made = to_ros2("my_msgs/T", f"{kind} stamp\n".encode())
    with pytest.raises(DecodeError, match="a time that the other version of ROS cannot express"):
        made.transcode(struct.pack("<II", *raw))


def test_names_become_legal() -> None:
    lines = "int32 angularRate\nFoo_bar my__nested_\nint32 MAX=0x10\nstring Label=a # b\nbyte class\n"
    text = f"{lines}{RULE}\nMSG: My_msgs/Foo_bar\nint8 a\n"
    made = to_ros2("My_msgs/lower_case", text.encode())
    assert made.name == "my_msgs/msg/LowerCase"
    assert made.definition.split(RULE)[0].splitlines() == [
        "int32 MAX=16",
        'string LABEL="a # b"',
        "int32 angularrate",
        "my_msgs/FooBar my_nested",
        "int8 class",
    ]


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("my_msgs/T", "int8 a\nint8 A\n", r"two fields 'a' in lower case"),
        (
            "sensor_msgs/Imu",
            "int8 a\n",
            r"it is not the sensor_msgs/Imu of ROS 2: sensor_msgs/Imu has the fields a, and",
        ),
        ("Nameless", "int8 a\n", r"'Nameless' is not a name that a type of ROS 2 can have"),
    ],
)
def test_what_has_no_type_in_ros_2_has_a_reason(name: str, text: str, reason: str) -> None:
    with pytest.raises(SchemaError, match=reason):
        to_ros2(name, text.encode())


@pytest.mark.parametrize("name", ["my_msgs/T); import os#", "my_msgs/T\nuint8 b", "my msgs/T", "my_msgs/T\0"])
def test_names_that_no_type_can_have_are_refused(name: str) -> None:
    with pytest.raises(SchemaError, match="is not a name that a type of ROS 2 can have"):
        to_ros2(name, b"int8 a\n")
    with pytest.raises(SchemaError, match="is not a name that a type of ROS 1 can have"):
        to_ros1(name, "ros2msg", b"int8 a\n")


def test_a_constant_may_contain_other_line_separators() -> None:
    text = f"string A=one\u2028my_msgs/B\nB b\n{RULE}\nMSG: my_msgs/B\nint8 a\n"
    nested = hashlib.md5(b"int8 a", usedforsecurity=False).hexdigest()
    expected = f"string A=one\u2028my_msgs/B\n{nested} b".encode()
    assert ros1_md5sum("my_msgs/T", text.encode()) == hashlib.md5(expected, usedforsecurity=False).hexdigest()


def test_old_names_of_types_are_those_of_ros_2() -> None:
    text, _ = NOETIC.generate_msgdef("geometry_msgs/msg/TransformStamped", ros_version=1)
    head, _, others = text.partition(RULE)
    stamped = f"MSG: geometry_msgs/TransformStamped\n{head}"
    made = to_ros2(
        "tf/tfMessage", f"geometry_msgs/TransformStamped[] transforms\n{RULE}\n{stamped}{RULE}{others}".encode()
    )
    assert made.name == "tf2_msgs/msg/TFMessage"


def test_a_byte_stays_unsigned() -> None:
    made = to_ros1("my_msgs/msg/T", "ros2msg", b"byte A=200\nbyte[<=3] data\nbool B=true\nstring N='a b'\n")
    assert made.definition == "uint8 A=200\nbool B=True\nstring N=a b\nuint8[] data\n"
    level = to_ros1("diagnostic_msgs/msg/KeyValue", "ros2msg", b"string key\nstring value\n")
    assert level.md5sum == "cf57fdc6617a881a88c16e768132149c"


def test_wide_texts_are_not_part_of_ros_1() -> None:
    with pytest.raises(SchemaError, match=r"wstring .*is not defined|wide text"):
        to_ros1("my_msgs/msg/T", "ros2msg", b"wstring a\n")


@pytest.mark.parametrize("seed", range(40))
def test_damaged_messages_are_refused_and_nothing_else(seed: int) -> None:
    """Whatever the bytes: a message, or `DecodeError`; what is accepted is what the decoder accepts."""
    chance = random.Random(seed)
    text = generated_definition(seed)
    there = to_ros2("a_msgs/Root", text.encode())
    back = to_ros1(there.name, "ros2msg", there.definition.encode())
    raw = random_ros1(parse_msg("a_msgs/Root", text, Ros.one), chance)
    for made, data in ((there, raw), (back, there.transcode(raw))):
        for _ in range(50):
            broken = bytearray(data)
            for _ in range(chance.randint(0, 3)):
                if broken:
                    broken[chance.randrange(len(broken))] = chance.choice((0, 1, 255, chance.randrange(256)))
            del broken[chance.randint(0, len(broken)) if chance.random() < 0.3 else len(broken) :]
            if chance.random() < 0.2:
                broken += chance.randbytes(5)
            try:
                result = made.transcode(bytes(broken))
            except DecodeError:
                continue
            if made is there:
                expected = decoded("ros1", "a_msgs/Root", "ros1msg", text, bytes(broken))
                assert repr(decoded("cdr", there.name, "ros2msg", there.definition, result)) == repr(expected)
