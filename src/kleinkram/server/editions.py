"""Edits that meet: who says which edition they looked at is told where somebody else came first."""

from typing import Annotated

from fastapi import Header

from kleinkram.contract.errors import EditConflict

# Source: RFC 9110, "If-Match".
IfMatch = Annotated[
    str | None, Header(alias="If-Match", max_length=1000, description="The `edition` that was looked at, in quotes.")
]


def require_edition(if_match: str | None, edition: str, *, noun: str, name: str) -> None:
    """See that a thing is still of an edition that its editor looked at; who names none is not asked.

    Raises:
        EditConflict: it is of another one by now.
    """
    if if_match is None:
        return
    looked_at = {each.strip().removeprefix("W/").strip('"') for each in if_match.split(",")}
    if not looked_at & {edition, "*"}:
        raise EditConflict(noun=noun, name=name, edition=edition)
