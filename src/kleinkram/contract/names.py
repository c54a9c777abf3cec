"""Rules for names, paths, labels and ids, used by the server, the SDK and, through OpenAPI, the web forms.

Two names are the same if their `name_key` is the same; unique indexes of the database use that key.
"""

import re
import unicodedata
import uuid
from pathlib import PurePosixPath
from typing import Annotated

from pydantic import AfterValidator, Field

MAX_NAME_CHARACTERS = 128
MAX_PATH_CHARACTERS = 1024
MAX_PATH_PART_BYTES = 255
# The size limit of an index entry, for the path and its key in UTF-8.
MAX_PATH_BYTES = 2400
MAX_LABEL_CHARACTERS = 64
MAX_TERM_CHARACTERS = 1024

_BIDI_CONTROLS = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
_UNSTORABLE = re.compile("[\x00\ud800-\udfff]")
_OF_RECORDING = re.compile(r"(?!tf:)(?P<recording>[^:].*?):(?P<rest>(/|tf:).+)", re.DOTALL)
_UUID = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}", re.IGNORECASE)


def name_key(name: str) -> str:
    """Return the form under which a name is unique: casefold of NFC, made NFC again.

    Source: Unicode Standard, section 3.13, canonical caseless matching.
    """
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _refuse_unprintable(text: str) -> None:
    for position, character in enumerate(text):
        if unicodedata.category(character) in {"Cc", "Cs", "Zl", "Zp"} or character in _BIDI_CONTROLS:
            raise ValueError(f"contains the control character U+{ord(character):04X} at position {position}")


def check_name(name: str) -> str:
    """Return the name of a project or mission in NFC. Raises ValueError."""
    name = unicodedata.normalize("NFC", name)
    _refuse_unprintable(name)
    if not name or name != name.strip():
        raise ValueError("is empty or begins or ends with a space")
    if len(name) > MAX_NAME_CHARACTERS:
        raise ValueError(f"has {len(name)} characters; {MAX_NAME_CHARACTERS} are allowed")
    if name in {".", ".."}:
        raise ValueError("is a folder reference, not a name")
    if bad := sorted(set(name) & set('/\\*?[]"')):
        raise ValueError(f"contains {' '.join(bad)}, which paths and wildcards use")
    if _UUID.fullmatch(name):
        raise ValueError("has the form of an id")
    return name


def check_file_path(path: str) -> str:
    """Return the path of a file in its mission in NFC.

    A path is relative, with `/` between its parts, and stays inside the mission. Raises ValueError.
    """
    path = unicodedata.normalize("NFC", path)
    _refuse_unprintable(path)
    if not path or path.startswith("/") or path.endswith("/"):
        raise ValueError("is not a relative path to a file")
    if "\\" in path:
        raise ValueError("contains a backslash, which is a folder separator on other systems")
    if len(path) > MAX_PATH_CHARACTERS:
        raise ValueError(f"has {len(path)} characters; {MAX_PATH_CHARACTERS} are allowed")
    size_bytes = max(len(path.encode()), len(name_key(path).encode()))
    if size_bytes > MAX_PATH_BYTES:
        raise ValueError(f"has {size_bytes} bytes; {MAX_PATH_BYTES} are allowed")
    for part in path.split("/"):
        if part in {"", ".", ".."}:
            raise ValueError(f"contains the part {part!r}")
        if len(part.encode()) > MAX_PATH_PART_BYTES:
            raise ValueError(f"has a part of {len(part.encode())} bytes; {MAX_PATH_PART_BYTES} are allowed")
    return path


def check_label(label: str) -> str:
    """Return a label in NFC. Raises ValueError."""
    label = unicodedata.normalize("NFC", label)
    _refuse_unprintable(label)
    if not label or label != label.strip() or "," in label:
        raise ValueError("is empty, contains a comma, or begins or ends with a space")
    if len(label) > MAX_LABEL_CHARACTERS:
        raise ValueError(f"has {len(label)} characters; {MAX_LABEL_CHARACTERS} are allowed")
    return label


def check_text(text: str) -> str:
    """Return a text that the database can store: without NUL and surrogates. Raises ValueError."""
    if (unstorable := _UNSTORABLE.search(text)) is not None:
        code, position = f"U+{ord(unstorable[0]):04X}", unstorable.start()
        raise ValueError(f"contains the character {code} at position {position}, which cannot be stored")
    return text


def split_trajectory_name(name: str) -> tuple[str | None, str]:
    """Return the recording that the name of a trajectory begins with, as in `nuc/nuc.mcap:/odom`, and the rest."""
    match = _OF_RECORDING.fullmatch(name)
    return (match["recording"], match["rest"]) if match else (None, name)


def read_frames(name: str) -> tuple[str, str] | None:
    """Return parent and child frame of `tf:map->base_link`; None for another name. Raises ValueError."""
    if not name.startswith("tf:"):
        return None
    parent, _, child = (part.strip() for part in name.removeprefix("tf:").partition("->"))
    if not (parent and child):
        raise ValueError("transforms are named like tf:map->base_link")
    return parent, child


def check_trajectory_name(name: str) -> str:
    """Return the name of a trajectory without spaces around it. Raises ValueError.

    It is a file of a mission or a glob of its path, a topic of poses, or transforms; of one recording, if it is named.
    """
    name = check_text(name).strip()
    if not name:
        raise ValueError("write a file, a topic such as /odom, or transforms such as tf:map->base_link")
    read_frames(split_trajectory_name(name)[1])
    return name


def is_id(reference: str) -> bool:
    """Return whether a reference is an id rather than a name."""
    return _UUID.fullmatch(reference) is not None


def file_name(path: str) -> str:
    """Return the last part of a file's path."""
    return PurePosixPath(path).name


Name = Annotated[str, AfterValidator(check_name), Field(min_length=1, max_length=MAX_NAME_CHARACTERS)]
FilePath = Annotated[str, AfterValidator(check_file_path), Field(min_length=1, max_length=MAX_PATH_CHARACTERS)]
Label = Annotated[str, AfterValidator(check_label), Field(min_length=1, max_length=MAX_LABEL_CHARACTERS)]
# A search word, glob or comparison.
Term = Annotated[str, AfterValidator(check_text), Field(max_length=MAX_TERM_CHARACTERS)]
Terms = Annotated[list[Term], Field(max_length=50)]
Ids = Annotated[list[uuid.UUID], Field(max_length=50)]
