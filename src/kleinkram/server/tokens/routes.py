"""Routes of tokens."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Page
from kleinkram.contract.tokens import TokenCreate, TokenMade, TokenRead
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageQuery
from kleinkram.server.tokens import service
from kleinkram.server.tokens.service import DerivedTokens

router = APIRouter(prefix="/api/v1/tokens", tags=["tokens"], responses=FAILURE_RESPONSES)


class TokenListQuery(PageQuery):
    """Query parameters of the list of tokens: your own; admins can list another person's, or everybody's."""

    person_id: uuid.UUID | None = None
    everybody: bool = False
    ended: bool = False


@router.post("", operation_id="create_token", status_code=201)
async def create_token(
    request: TokenCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> TokenMade:
    """Create a token; its secret is shown only once, in this response."""
    return await service.create_token(db, actor, request=request, settings=settings)


@router.get("", operation_id="list_tokens")
async def list_tokens(
    query: Annotated[TokenListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[TokenRead]:
    """List tokens, latest first; with `ended`, also revoked and expired ones."""
    person_id = None if query.everybody else query.person_id or actor.person_id
    return await service.list_tokens(db, actor, person_id=person_id, with_ended=query.ended, page=query.page)


@router.delete("/{token_id}", operation_id="revoke_token", status_code=204)
async def revoke_token(
    token_id: uuid.UUID, db: Transaction, actor: CurrentActor, made: DerivedTokens = DerivedTokens.ended
) -> None:
    """Revoke a token and all that were created with it, from the next request on; with `made=valid`, only itself."""
    await service.revoke_token(db, actor, token_id=token_id, derived=made)
