"""Conditional edits: the If-Match header and the check of an object's ETag (RFC 9110, section 13.1.1)."""

from typing import Annotated

from fastapi import Header

from kleinkram.contract.errors import EditConflict

IfMatch = Annotated[
    str | None,
    Header(alias="If-Match", max_length=1000, description="The `etag` of the object that was edited, in quotes."),
]


def require_match(if_match: str | None, etag: str, *, noun: str, name: str) -> None:
    """Check that an object still has one of the ETags in an If-Match header; without a header, there is no check.

    Raises:
        EditConflict: somebody else changed the object meanwhile.
    """
    if if_match is None:
        return
    expected = {part.strip().removeprefix("W/").strip('"') for part in if_match.split(",")}
    if not expected & {etag, "*"}:
        raise EditConflict(noun=noun, name=name, etag=etag)
