"""Tokens: what scripts, robots and runners carry instead of a person's sign-in."""

import datetime
import uuid
from typing import Annotated

from pydantic import Field, model_validator
from typing_extensions import Self

from kleinkram.contract.expiry import Expiry
from kleinkram.contract.names import Label
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import Scope, TokenKind
from kleinkram.contract.wire import Request, Response

DEFAULT_SCOPES = {
    TokenKind.personal: (Scope.write,),
    TokenKind.robot: (Scope.upload,),
    TokenKind.runner: (Scope.run,),
    TokenKind.run: (Scope.read,),
}
Places = Annotated[list[uuid.UUID], Field(max_length=100)]


class TokenCreate(Request):
    """A token to make. Without `scopes`, those usual for its kind; without limits, it reaches what its person reaches.

    A robot's token is limited to projects or missions and is never for administration. A runner's is for runs alone,
    and for one runner: `runner_id`, else the first one that uses it. With projects it gets only runs on these, with
    `runner_labels` only runs that ask for one of them.

    Without `expires_at` it ends after the time that the server's settings name. `no_end` takes a server that allows it.
    """

    name: Label
    kind: TokenKind = TokenKind.personal
    scopes: Annotated[list[Scope], Field(min_length=1, max_length=len(Scope))] | None = None
    project_ids: Places = []
    mission_ids: Places = []
    expires_at: Expiry | None = None
    no_end: bool = False
    runner_id: uuid.UUID | None = None
    runner_labels: Annotated[list[Label], Field(min_length=1, max_length=50)] | None = None

    @property
    def chosen_scopes(self) -> list[Scope]:
        """The scopes it gets, each once."""
        return list(dict.fromkeys(self.scopes if self.scopes is not None else DEFAULT_SCOPES[self.kind]))

    @property
    def is_limited(self) -> bool:
        """Whether it reaches only what is named."""
        return bool(self.project_ids or self.mission_ids)

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        if self.kind is TokenKind.run:
            raise ValueError("a run's token comes with the run; nobody makes one")
        if self.kind is TokenKind.robot and not self.is_limited:
            raise ValueError("a robot's token must be limited to projects or missions")
        if self.kind is TokenKind.robot and Scope.admin in self.chosen_scopes:
            raise ValueError("a robot's token cannot have the scope admin")
        if self.kind is TokenKind.runner and (self.mission_ids or self.chosen_scopes != [Scope.run]):
            raise ValueError("a runner's token has the scope run and no other, and is limited to projects at most")
        if self.kind is not TokenKind.runner and (self.runner_id or self.runner_labels):
            raise ValueError("only a runner's token names a runner or labels")
        if self.no_end and self.expires_at is not None:
            raise ValueError("say expires_at or no_end, not both")
        return self


class TokenPlace(Response):
    """A project or mission that a token is limited to. `name` is null where whoever asks may not see it (any more)."""

    noun: str
    id: uuid.UUID
    name: str | None


class TokenRunner(Response):
    """The runner that a token is bound to. `name` is null until it has said hello."""

    id: uuid.UUID
    name: str | None


class TokenRead(Response):
    """A token without its secret; `prefix` is how that begins.

    `limits` are null where it reaches what its person reaches, and empty where all it was limited to is gone.
    `last_used_at` is exact to a minute. `runner` is null of a runner's token that no runner has used yet.
    """

    id: uuid.UUID
    person: PersonRef
    name: str
    kind: TokenKind
    prefix: str
    scopes: list[Scope]
    limits: list[TokenPlace] | None
    created_at: datetime.datetime
    expires_at: datetime.datetime | None
    last_used_at: datetime.datetime | None
    revoked_at: datetime.datetime | None
    runner: TokenRunner | None = None
    runner_labels: list[str] | None = None


class TokenMade(Response):
    """A new token with its secret, which nobody can show again."""

    token: TokenRead
    secret: Annotated[str, Field(repr=False)]
