"""How the secrets of tokens and links look, so that people, programs and secret scanners can tell them.

A secret is `klein_` and its kind, `_`, 43 characters of URL-safe base64 (256 random bits), and 6 characters that are a
checksum of all before them: the CRC-32 of its ASCII in base 62 (`0-9A-Za-z`), most significant digit first. The
checksum tells a secret that was cut or mistyped from one that is unknown, and a scanner's find from a chance.
"""

import enum
import re
import string
import zlib

_DIGITS = string.digits + string.ascii_uppercase + string.ascii_lowercase
CHECKSUM_CHARACTERS = 6
RANDOM_CHARACTERS = 43
# What a scanner looks for; `is_whole` then says whether the find is one.
PATTERN = r"klein_(?:pat|robot|runner|run|link)_[A-Za-z0-9_-]{43}[0-9A-Za-z]{6}"
_PATTERN = re.compile(PATTERN, re.ASCII)


class SecretKind(str, enum.Enum):
    """What a secret opens: what a person, a robot, a runner or a run may do, or what a link shows."""

    personal = "pat"
    robot = "robot"
    runner = "runner"
    run = "run"
    link = "link"


def with_checksum(text: str) -> str:
    """Return `text` (ASCII) with its checksum behind it."""
    rest, digits = zlib.crc32(text.encode("ascii")), ""
    for _ in range(CHECKSUM_CHARACTERS):
        rest, digit = divmod(rest, len(_DIGITS))
        digits = _DIGITS[digit] + digits
    return text + digits


def is_whole(secret: str) -> bool:
    """Say whether a secret is one of ours to the last character; it may still have ended, or never have been given."""
    return _PATTERN.fullmatch(secret) is not None and with_checksum(secret[:-CHECKSUM_CHARACTERS]) == secret


def is_mangled(secret: str) -> bool:
    """Say whether a secret was meant to be one of ours, but was cut or mistyped."""
    return secret.startswith(tuple(f"klein_{kind.value}_" for kind in SecretKind)) and not is_whole(secret)
