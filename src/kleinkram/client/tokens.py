"""Tokens, for programs."""

import builtins
import datetime
import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from kleinkram.client._http import Api, query_of
from kleinkram.client._paging import Listing, pages
from kleinkram.client.checking import checked
from kleinkram.client.missions import Missions
from kleinkram.client.projects import Projects
from kleinkram.client.references import Ref, known_id, the_one
from kleinkram.contract.rights import Scope, TokenKind
from kleinkram.contract.tokens import TokenCreate, TokenMade, TokenRead


@dataclass(frozen=True)
class Reach:
    """The projects and missions that a token is limited to; with none of either, it is not limited."""

    project_ids: Sequence[Ref] = ()
    mission_ids: Sequence[Ref] = ()


@dataclass(frozen=True)
class RunnerLimits:
    """Which runner a runner's token is for, None: the first that uses it; and the labels that its runs ask for."""

    runner_id: uuid.UUID | None = None
    labels: Sequence[str] = ()


class Tokens:
    """`client.tokens`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def create(
        self,
        name: str,
        *,
        kind: TokenKind = TokenKind.personal,
        scopes: Sequence[Scope] | None = None,
        reach: Reach | None = None,
        expires_at: datetime.datetime | None = None,
        no_end: bool = False,
        runner: RunnerLimits | None = None,
    ) -> TokenMade:
        """Make a token and return it with its secret, which can never be shown again.

        Without `scopes` it gets those usual for its kind: write for a person's, upload for a robot's, run for a
        runner's. Without `expires_at` it ends after the time that the server's settings name; `no_end` takes a server
        that allows it.

        Raises:
            TokenTooWide: it could do more than the token of this client.
            NotFound: a project or mission to limit it to is not there.
            Forbidden: tokens for runners are made by admins.
            SignInTooOld: it has the scope admin, and one signed in too long ago.
            InvalidInput: it is not one that can be; a robot's, for one, must be limited.
        """
        given: dict[str, object] = {"name": name, "kind": kind}
        if expires_at is not None:
            given["expires_at"] = expires_at
        if no_end:
            given["no_end"] = True
        if runner is not None and runner.runner_id is not None:
            given["runner_id"] = runner.runner_id
        if runner is not None and runner.labels:
            given["runner_labels"] = [*runner.labels]
        if scopes is not None:
            given["scopes"] = [*scopes]
        if reach is not None:
            given["project_ids"] = [Projects(self._api).id_of(ref) for ref in reach.project_ids]
            given["mission_ids"] = [Missions(self._api).id_of(ref) for ref in reach.mission_ids]
        return self._api.send("POST", "/tokens", TokenMade, checked(TokenCreate, "The token", **given))

    def list(self, *, everybody: bool = False, ended: bool = False, limit: int | None = None) -> Listing[TokenRead]:
        """Yield one's tokens, latest first; with `ended` those that are over, too. `everybody` is for admins."""
        query = query_of(None, everybody=everybody or None, ended=ended or None)
        return pages(self._api, "/tokens", TokenRead, query, limit=limit)

    def get(self, ref: Ref, *, everybody: bool = False) -> TokenRead:
        """Return the token with this id, name, or beginning of its secret; `everybody` is for admins.

        Raises:
            NotFound: there is none that can still be used.
            AmbiguousName: several have that name.
        """
        rows: builtins.list[TokenRead] = [*self.list(everybody=everybody)]
        if (token_id := known_id(ref, "token")) is not None:
            return the_one("token", str(token_id), rows, name=lambda row: str(row.id), label=token_label)
        said = str(ref)
        begun = [row for row in rows if row.prefix and said.startswith(row.prefix)]
        return begun[0] if len(begun) == 1 else the_one("token", said, rows, name=_name, label=token_label)

    def revoke(self, token: Ref) -> None:
        """End a token, those that were made with it, and those made with these, from the next request on.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        self._api.delete(f"/tokens/{known_id(token, 'token') or self.get(token).id}")


def token_label(token: TokenRead) -> str:
    """Return how a token is listed among candidates."""
    return f"{token.name} ({token.prefix}…, {token.id})"


def _name(token: TokenRead) -> str:
    return token.name
