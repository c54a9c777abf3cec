"""Links for people without an account, for programs."""

import builtins
import datetime
import uuid
from collections.abc import Sequence

from kleinkram.client._http import Api, query_of
from kleinkram.client._paging import Listing, pages
from kleinkram.client.checking import checked
from kleinkram.client.missions import Missions
from kleinkram.client.references import HasId, Ref, known_id, the_one
from kleinkram.contract.shares import ShareCreate, SharedRead, ShareMade, ShareRead


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
        given: dict[str, object] = {"name": name, "expires_at": expires_at}
        given |= {} if file_ids is None else {"file_ids": [known_id(each, "file") for each in file_ids]}
        body = checked(ShareCreate, "The link", **given)
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
            return the_one("link", str(share_id), rows, name=lambda row: str(row.id), label=share_label)
        said = str(ref)
        secret = said.rpartition("#")[2]
        begun = [row for row in rows if secret.startswith(row.prefix)]
        return begun[0] if len(begun) == 1 else the_one("link", said, rows, name=_name, label=share_label)

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


def _name(share: ShareRead) -> str:
    return share.name
