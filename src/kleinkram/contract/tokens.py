"""Tokens of scripts, robots and runners, and share links: secrets that give access without a sign-in."""

import datetime
import uuid
from typing import Annotated

from pydantic import Field, model_validator
from typing_extensions import Self

from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.base import Expiry, Request, Response
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.names import Label
from kleinkram.contract.people import PersonRef

DEFAULT_SCOPES = {
    TokenKind.personal: (Scope.write,),
    TokenKind.robot: (Scope.upload,),
    TokenKind.runner: (Scope.run,),
    TokenKind.run: (Scope.read,),
}
LimitIds = Annotated[list[uuid.UUID], Field(max_length=100)]


class TokenCreate(Request):
    """A token to create. Default `scopes` depend on its kind; without limits it reaches everything its person may see.

    A robot's token is limited to projects or missions and cannot have the scope admin. A runner's token is for one
    runner: `runner_id`, else the first one that uses it. With projects it gets only runs on these, with `runner_labels`
    only runs that require one of them. Without `expires_at`, the server's settings decide; some servers allow `no_end`.
    """

    name: Label
    kind: TokenKind = TokenKind.personal
    scopes: Annotated[list[Scope], Field(min_length=1, max_length=len(Scope))] | None = None
    project_ids: LimitIds = []
    mission_ids: LimitIds = []
    expires_at: Expiry | None = None
    no_end: bool = False
    runner_id: uuid.UUID | None = None
    runner_labels: Annotated[list[Label], Field(min_length=1, max_length=50)] | None = None

    @property
    def chosen_scopes(self) -> list[Scope]:
        """The scopes without duplicates, or the default ones."""
        return list(dict.fromkeys(self.scopes if self.scopes is not None else DEFAULT_SCOPES[self.kind]))

    @property
    def is_limited(self) -> bool:
        """Whether it is limited to projects or missions."""
        return bool(self.project_ids or self.mission_ids)

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        if self.kind is TokenKind.run:
            raise ValueError("a run's token is created with the run, not by people")
        if self.kind is TokenKind.robot and not self.is_limited:
            raise ValueError("a robot's token must be limited to projects or missions")
        if self.kind is TokenKind.robot and Scope.admin in self.chosen_scopes:
            raise ValueError("a robot's token cannot have the scope admin")
        if self.kind is TokenKind.runner and (self.mission_ids or self.chosen_scopes != [Scope.run]):
            raise ValueError("a runner's token has the scope run and no other, and is limited to projects at most")
        if self.kind is not TokenKind.runner and (self.runner_id or self.runner_labels):
            raise ValueError("only a runner's token names a runner or labels")
        if self.no_end and self.expires_at is not None:
            raise ValueError("specify expires_at or no_end, not both")
        return self


class TokenLimit(Response):
    """A project or mission to which a token is limited. `name` is null if the caller may not see it."""

    resource_type: str
    id: uuid.UUID
    name: str | None


class TokenRunner(Response):
    """The runner to which a token is bound. `name` is null until the runner registers."""

    id: uuid.UUID
    name: str | None


class TokenRead(Response):
    """A token without its secret; `prefix` is the beginning of the secret.

    `limits` are null for an unlimited token, and empty if everything it was limited to was deleted. `last_used_at` is
    exact to a minute. `runner` is null until a runner uses the token.
    """

    id: uuid.UUID
    person: PersonRef
    name: str
    kind: TokenKind
    prefix: str
    scopes: list[Scope]
    limits: list[TokenLimit] | None
    created_at: datetime.datetime
    expires_at: datetime.datetime | None
    last_used_at: datetime.datetime | None
    revoked_at: datetime.datetime | None
    runner: TokenRunner | None = None
    runner_labels: list[str] | None = None


class TokenMade(Response):
    """A new token with its secret, which cannot be shown again."""

    token: TokenRead
    secret: Annotated[str, Field(repr=False)]


# The page that a link opens; the secret follows after a `#`, so that no log contains it.
SHARE_PAGE = "/s"
MAX_SHARED_FILES = 2_000


def is_link(text: str) -> bool:
    """Return whether a text is the address of a share link."""
    return text.startswith(("http://", "https://")) and f"{SHARE_PAGE}#" in text


class ShareCreate(Request):
    """A link to create: to files of a mission, or with `file_ids` null to everything in it, now and later."""

    name: Label
    file_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_SHARED_FILES)] | None = None
    expires_at: Expiry


class ShareRead(Response):
    """A link without its secret; `prefix` is the beginning of the secret.

    `file_count` is null for a link to all files of a mission. Downloads count each file whose URL was requested.
    """

    id: uuid.UUID
    name: str
    mission: MissionRef
    file_count: int | None
    prefix: str
    created_by: PersonRef
    created_at: datetime.datetime
    expires_at: datetime.datetime
    revoked_at: datetime.datetime | None
    last_used_at: datetime.datetime | None
    download_count: int
    download_bytes: int


class ShareMade(Response):
    """A new link with its secret, which cannot be shown again. `url` contains the secret."""

    share: ShareRead
    url: Annotated[str, Field(repr=False)]
    secret: Annotated[str, Field(repr=False)]


class SharedRead(Response):
    """Current content of a share link."""

    name: str
    mission: MissionRef
    is_whole_mission: bool
    file_count: int
    size_bytes: int
    expires_at: datetime.datetime
