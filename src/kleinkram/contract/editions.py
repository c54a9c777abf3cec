"""Editions: what tells two states of a thing apart, as far as people edit it.

The same words give the same edition, whoever wrote them and how often; what jobs find out changes none.
"""

import hashlib
from typing import Annotated

from pydantic import Field
from pydantic_core import to_json

# An ETag without its quotes.
Edition = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


def edition_of(*edited: object) -> str:
    """Return the edition of a thing of which people edit these values, by how JSON writes them."""
    return hashlib.sha256(to_json(edited)).hexdigest()[:16]
