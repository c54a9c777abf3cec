"""Text from untrusted files, made to fit into the database whatever it holds."""

import hashlib
from typing import overload

# A row of an index holds 2704 bytes: a topic's name and type together stay well below.
_LIMIT_BYTES = 1000


@overload
def fit(text: str) -> str: ...
@overload
def fit(text: None) -> None: ...
def fit(text: str | None) -> str | None:
    """Return `text` without what PostgreSQL cannot hold (NUL, lone surrogates), at most 1000 bytes of UTF-8.

    Longer text is cut and ends with a hash of all of it, so that two that differ still do.
    """
    if text is None:
        return None
    whole = text.encode("utf-8", "backslashreplace").replace(b"\0", b"\\0")
    if len(whole) > _LIMIT_BYTES:
        whole = whole[: _LIMIT_BYTES - 20] + b"..." + hashlib.sha256(whole).hexdigest()[:16].encode()
    return whole.decode("utf-8", "ignore")
