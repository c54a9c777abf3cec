"""Tokens over HTTP."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.contract.tokens import TokenCreate, TokenMade, TokenRead
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.paging import PageRequest
from kleinkram.server.tokens import service

router = APIRouter(prefix="/api/v1/tokens", tags=["tokens"])


class TokenListQuery(BaseModel):
    """The query of a list of tokens: one's own; for admins also another's, or everybody's."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    person_id: uuid.UUID | None = None
    everybody: bool = False
    ended: bool = False
    limit: PageSize = 100
    cursor: Cursor | None = None


@router.post("", operation_id="create_token", status_code=201)
async def create_token(
    wanted: TokenCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> TokenMade:
    """Make a token; its secret is shown here and never again."""
    return await service.create_token(db, actor, wanted=wanted, settings=settings)


@router.get("", operation_id="list_tokens")
async def list_tokens(
    query: Annotated[TokenListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[TokenRead]:
    """List tokens, latest first; with `ended` also those that were revoked or have expired."""
    whose = service.Whose(None if query.everybody else query.person_id or actor.person_id)
    page = PageRequest(query.limit, query.cursor)
    return await service.list_tokens(db, actor, whose=whose, with_ended=query.ended, page=page)


@router.delete("/{token_id}", operation_id="revoke_token", status_code=204)
async def revoke_token(
    token_id: uuid.UUID, db: Transaction, actor: CurrentActor, made: service.Made = service.Made.ended
) -> None:
    """End a token and all that were made with it, from the next request on; with `made=kept` only itself."""
    await service.revoke_token(db, actor, token_id=token_id, made=made)
