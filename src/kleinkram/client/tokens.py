"""Tokens for scripts and robots, and share links for people without an account."""

import builtins
import datetime
import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, HasId, Listing, Ref, checked, known_id, pages, resolve_one
from kleinkram.client.missions import Missions, Projects
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.tokens import ShareCreate, SharedRead, ShareMade, ShareRead, TokenCreate, TokenMade, TokenRead


@dataclass(frozen=True)
class Reach:
    """The projects and missions that a token is limited to; without any, it is not limited."""

    project_ids: Sequence[Ref] = ()
    mission_ids: Sequence[Ref] = ()


@dataclass(frozen=True)
class RunnerLimits:
    """The runner that a token is for (None: the first that uses it), and the labels that its runs must ask for."""

    runner_id: uuid.UUID | None = None
    labels: Sequence[str] = ()


class Tokens(ApiResource):
    """`client.tokens`."""

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
        """Create a token and return it with its secret, which can never be shown again.

        The default `scopes` are those of its kind: write for a person, upload for a robot, run for a runner. The
        default end is set by the server; `no_end` requires a server that allows it.

        Raises:
            TokenTooWide: it could do more than the token of this client.
            Forbidden: only admins can create tokens for runners.
            SignInTooOld: it has the scope admin, and one signed in too long ago.
            InvalidInput: the values do not go together; a robot's token, for example, must be limited.
        """
        values: dict[str, object] = {
            "name": name,
            "kind": kind,
            "scopes": None if scopes is None else [*scopes],
            "expires_at": expires_at,
            "no_end": no_end or None,
            "runner_id": runner.runner_id if runner else None,
            "runner_labels": ([*runner.labels] or None) if runner else None,
        }
        if reach is not None:
            values["project_ids"] = [Projects(self._api).id_of(ref) for ref in reach.project_ids]
            values["mission_ids"] = [Missions(self._api).id_of(ref) for ref in reach.mission_ids]
        set_values = {key: value for key, value in values.items() if value is not None}
        return self._api.send("POST", "/tokens", TokenMade, checked(TokenCreate, "The token", **set_values))

    def list(self, *, everybody: bool = False, ended: bool = False, limit: int | None = None) -> Listing[TokenRead]:
        """Yield one's tokens, latest first; with `ended` including ended ones. `everybody` is for admins."""
        query = query_of(None, everybody=everybody or None, ended=ended or None)
        return pages(self._api, "/tokens", TokenRead, query, limit=limit)

    def get(self, ref: Ref, *, everybody: bool = False) -> TokenRead:
        """Return the token with this id, name, or beginning of its secret, if it has not ended."""
        rows: builtins.list[TokenRead] = [*self.list(everybody=everybody)]
        if (token_id := known_id(ref, "token")) is not None:
            return resolve_one("token", str(token_id), rows, name=lambda row: str(row.id), label=token_label)
        name = str(ref)
        begun = [row for row in rows if row.prefix and name.startswith(row.prefix)]
        if len(begun) == 1:
            return begun[0]
        return resolve_one("token", name, rows, name=lambda row: row.name, label=token_label)

    def revoke(self, token: Ref) -> None:
        """Revoke a token, and all that were made with it, from the next request on."""
        self._api.delete(f"/tokens/{known_id(token, 'token') or self.get(token).id}")


def token_label(token: TokenRead) -> str:
    """Return a token as it is listed among candidates."""
    return f"{token.name} ({token.prefix}…, {token.id})"


class Shares(ApiResource):
    """`client.shares`."""

    def create(
        self,
        mission_id: Ref,
        name: str,
        *,
        expires_at: datetime.datetime,
        file_ids: Sequence[uuid.UUID | HasId] | None = None,
    ) -> ShareMade:
        """Create a link to a mission, or to some of its files, and return it with its address, which is its secret.

        It requires WRITE on the mission. InvalidRequest: it lasts longer than the server's settings allow.
        """
        values: dict[str, object] = {"name": name, "expires_at": expires_at}
        values |= {} if file_ids is None else {"file_ids": [known_id(file_id, "file") for file_id in file_ids]}
        body = checked(ShareCreate, "The link", **values)
        return self._api.send("POST", f"/missions/{Missions(self._api).id_of(mission_id)}/shares", ShareMade, body)

    def list(
        self, *, mission_id: Ref | None = None, ended: bool = False, limit: int | None = None
    ) -> Listing[ShareRead]:
        """Yield the links that one may revoke, latest first; with `ended` including ended ones."""
        mission = None if mission_id is None else Missions(self._api).id_of(mission_id)
        query = query_of(None, mission_id=mission, ended=ended or None)
        return pages(self._api, "/shares", ShareRead, query, limit=limit)

    def get(self, ref: Ref) -> ShareRead:
        """Return the link with this id, name, address or secret, if it has not ended."""
        rows: builtins.list[ShareRead] = [*self.list()]
        if (share_id := known_id(ref, "link")) is not None:
            return resolve_one("link", str(share_id), rows, name=lambda row: str(row.id), label=share_label)
        name = str(ref)
        secret = name.rpartition("#")[2]
        begun = [row for row in rows if secret.startswith(row.prefix)]
        if len(begun) == 1:
            return begun[0]
        return resolve_one("link", name, rows, name=lambda row: row.name, label=share_label)

    def revoke(self, share: Ref) -> None:
        """Revoke a link, from the next request on."""
        self._api.delete(f"/shares/{known_id(share, 'link') or self.get(share).id}")

    def shown(self) -> SharedRead:
        """Return what the link that this client was opened with shows."""
        return self._api.get("/share", SharedRead)


def share_label(share: ShareRead) -> str:
    """Return a link as it is listed among candidates."""
    return f"{share.name} ({share.prefix}…, {share.id})"
