"""Taking secrets out of what a run writes, piece by piece, and never half of one.

What is a secret: the tokens that the caller names, all that looks like one of ours, and the signatures of addresses.
"""

import re
from collections.abc import Collection

REDACTED = b"[redacted]"
# No secret is longer. So what is so far from the end of what was read is known in whole.
_LONGEST = 512
_SHORTEST = 16
_KNOWN = (
    rb"klein_[a-z]{1,16}_[A-Za-z0-9_-]{43}[0-9A-Za-z]{6}",
    rb"(X-Amz-(?:Signature|Credential|Security-Token)=)[0-9A-Za-z%/._+-]{1,256}",
)

_MARKS = (b"klein_", b"X-Amz-")


class Redactor:
    """Takes out what it was told, and what it knows."""

    def __init__(self, secrets: Collection[str]) -> None:
        told = [secret.encode() for secret in secrets if _SHORTEST <= len(secret) <= _LONGEST // 2]
        self._pattern = re.compile(b"|".join([*map(re.escape, told), *_KNOWN]))
        # Looked for first: most of what is written has none of these, and a pattern is a hundred times slower.
        self._marks = [*told, *_MARKS]

    def clean(self, data: bytes) -> bytes:
        """Return text without secrets. It may be a piece as `cut` tells."""
        if not any(mark in data for mark in self._marks):
            return data
        return self._pattern.sub(lambda found: (found.group(1) or b"") + REDACTED, data)

    def cut(self, data: bytes, most_bytes: int) -> int:
        """Return how many of these bytes can be cleaned now, without the ones that follow them; 0 for none yet.

        Whole lines, since no secret goes over the end of one; where there is none in `most_bytes`, what cannot be part
        of a secret that goes on.
        """
        window = data[:most_bytes]
        lines = max(window.rfind(b"\n"), window.rfind(b"\r")) + 1
        if lines > 0 or len(window) < most_bytes:
            return lines
        end = most_bytes - _LONGEST
        for match in self._pattern.finditer(window):
            if match.start() < end < match.end():
                return match.start()
        return end
