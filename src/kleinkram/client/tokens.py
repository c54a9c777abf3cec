"""Tokens for scripts and robots, and share links for people without an account."""

import builtins
import datetime
import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import HasId, Listing, Ref, checked, known_id, pages, resolve_one
from kleinkram.client.missions import Missions
from kleinkram.client.projects import Projects
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.tokens import ShareCreate, SharedRead, ShareMade, ShareRead, TokenCreate, TokenMade, TokenRead


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
        values: dict[str, object] = {"name": name, "kind": kind}
        if expires_at is not None:
            values["expires_at"] = expires_at
        if no_end:
            values["no_end"] = True
        if runner is not None and runner.runner_id is not None:
            values["runner_id"] = runner.runner_id
        if runner is not None and runner.labels:
            values["runner_labels"] = [*runner.labels]
        if scopes is not None:
            values["scopes"] = [*scopes]
        if reach is not None:
            values["project_ids"] = [Projects(self._api).id_of(ref) for ref in reach.project_ids]
            values["mission_ids"] = [Missions(self._api).id_of(ref) for ref in reach.mission_ids]
        return self._api.send("POST", "/tokens", TokenMade, checked(TokenCreate, "The token", **values))

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
            return resolve_one("token", str(token_id), rows, name=lambda row: str(row.id), label=token_label)
        name = str(ref)
        begun = [row for row in rows if row.prefix and name.startswith(row.prefix)]
        return begun[0] if len(begun) == 1 else resolve_one("token", name, rows, name=_token_name, label=token_label)

    def revoke(self, token: Ref) -> None:
        """End a token, those that were made with it, and those made with these, from the next request on.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        self._api.delete(f"/tokens/{known_id(token, 'token') or self.get(token).id}")


def token_label(token: TokenRead) -> str:
    """Return how a token is listed among candidates."""
    return f"{token.name} ({token.prefix}…, {token.id})"


def _token_name(token: TokenRead) -> str:
    return token.name


class Shares:
    """`client.shares`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def create(
        self,
        mission_id: Ref,
        name: str,
        *,
        expires_at: datetime.datetime,
        file_ids: Sequence[uuid.UUID | HasId] | None = None,
    ) -> ShareMade:
        """Make a link to a mission, or to some of its files, and return it with its address, which is its secret.

        Raises:
            Forbidden: it takes WRITE on the mission.
            NotFound: one of the files is not in the mission.
            InvalidRequest: it lasts longer than the server's settings allow.
            InvalidInput: the name is not usable.
        """
        values: dict[str, object] = {"name": name, "expires_at": expires_at}
        values |= {} if file_ids is None else {"file_ids": [known_id(file_id, "file") for file_id in file_ids]}
        body = checked(ShareCreate, "The link", **values)
        return self._api.send("POST", f"/missions/{Missions(self._api).id_of(mission_id)}/shares", ShareMade, body)

    def list(
        self, *, mission_id: Ref | None = None, ended: bool = False, limit: int | None = None
    ) -> Listing[ShareRead]:
        """Yield the links that one may revoke, latest first; with `ended` those that are over, too."""
        mission = None if mission_id is None else Missions(self._api).id_of(mission_id)
        query = query_of(None, mission_id=mission, ended=ended or None)
        return pages(self._api, "/shares", ShareRead, query, limit=limit)

    def get(self, ref: Ref) -> ShareRead:
        """Return the link with this id or name, or whose address or secret this is.

        Raises:
            NotFound: there is none that can still be used.
            AmbiguousName: several have that name.
        """
        rows: builtins.list[ShareRead] = [*self.list()]
        if (share_id := known_id(ref, "link")) is not None:
            return resolve_one("link", str(share_id), rows, name=lambda row: str(row.id), label=share_label)
        name = str(ref)
        secret = name.rpartition("#")[2]
        begun = [row for row in rows if secret.startswith(row.prefix)]
        return begun[0] if len(begun) == 1 else resolve_one("link", name, rows, name=_share_name, label=share_label)

    def revoke(self, share: Ref) -> None:
        """End a link, from the next request on.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        self._api.delete(f"/shares/{known_id(share, 'link') or self.get(share).id}")

    def shown(self) -> SharedRead:
        """Return what the link shows that this client came with.

        Raises:
            NotFound: it came with none.
        """
        return self._api.get("/share", SharedRead)


def share_label(share: ShareRead) -> str:
    """Return how a link is listed among candidates."""
    return f"{share.name} ({share.prefix}…, {share.id})"


def _share_name(share: ShareRead) -> str:
    return share.name
