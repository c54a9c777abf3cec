"""ETags: a hash of the values of an object that people edit. Changes that jobs make do not alter it."""

import hashlib
from typing import Annotated

from pydantic import Field
from pydantic_core import to_json

ETag = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
"""An ETag without its quotes."""


def etag_of(*editable: object) -> str:
    """Return the ETag of an object with these editable values, hashed as JSON."""
    return hashlib.sha256(to_json(editable)).hexdigest()[:16]
