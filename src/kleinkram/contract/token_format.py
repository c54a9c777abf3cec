"""The form of secrets. Imports nothing of ours, so that the supervisor of `klein up` starts quickly."""

import enum
import re
import string
import zlib

_DIGITS = string.digits + string.ascii_uppercase + string.ascii_lowercase
CHECKSUM_CHARACTERS = 6
# For secret scanners; `has_valid_checksum` then verifies a match.
PATTERN = r"klein_(?:pat|robot|runner|run|link)_[A-Za-z0-9_-]{43}[0-9A-Za-z]{6}"
_PATTERN = re.compile(PATTERN, re.ASCII)


class SecretKind(str, enum.Enum):
    """Kind of a secret: a token of a person, robot, runner or run, or a share link."""

    personal = "pat"
    robot = "robot"
    runner = "runner"
    run = "run"
    link = "link"


def with_checksum(text: str) -> str:
    """Return `text` (ASCII) with its checksum: the CRC-32 in base 62, most significant digit first."""
    rest, digits = zlib.crc32(text.encode("ascii")), ""
    for _ in range(CHECKSUM_CHARACTERS):
        rest, digit = divmod(rest, len(_DIGITS))
        digits = _DIGITS[digit] + digits
    return text + digits


def has_valid_checksum(secret: str) -> bool:
    """Return whether a secret has the right form and checksum; it may still be revoked, or never have been issued."""
    return _PATTERN.fullmatch(secret) is not None and with_checksum(secret[:-CHECKSUM_CHARACTERS]) == secret
