"""Who may do what with a project or a mission, for programs."""

import datetime
import uuid
from collections.abc import Iterator

from kleinkram.client._http import Api
from kleinkram.client._paging import Listing, pages
from kleinkram.client.checking import checked
from kleinkram.client.groups import Groups
from kleinkram.client.people import People
from kleinkram.client.references import Ref, known_id, the_one
from kleinkram.contract.errors import NotFound
from kleinkram.contract.grants import AccessRead, GrantCreate, Grantee, GranteeKind, GrantRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.names import is_id
from kleinkram.contract.projects import ProjectRead
from kleinkram.contract.rights import Right

Place = ProjectRead | MissionRead


class Access:
    """`client.access`. A place is a project or a mission, as `client.projects` and `client.missions` give them."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def ways(self, place: Place) -> Listing[AccessRead]:
        """Yield who has a right on a place now, and by what; without WRITE there, only one's own ways."""
        return pages(self._api, f"{_path(place)}/access", AccessRead, [])

    def grants(self, place: Place) -> Listing[GrantRead]:
        """Yield the grants on a place itself, by the name of whom they are to; those that have expired too."""
        return pages(self._api, f"{_path(place)}/grants", GrantRead, [])

    def grant(
        self, place: Place, to: Grantee | str, right: Right, *, expires_at: datetime.datetime | None = None
    ) -> GrantRead:
        """Give a right, in place of the one that was given there to the same one before.

        `to` is whom `grantee` returns, or what it takes: an address, a name or an id.

        Raises:
            RightExceeded: it is more, or for longer, than one holds.
            LastOwner: it takes the place of the last lasting owner's.
            InvalidInput: the address is none, or the time has no zone.
        """
        to = self.grantee(to) if isinstance(to, str) else to
        whom = {"email": to.name} if to.kind is GranteeKind.email else {f"{to.kind.value}_id": to.id}
        body = checked(GrantCreate, "The grant", **whom, right=right, expires_at=expires_at)
        return self._api.send("POST", f"{_path(place)}/grants", GrantRead, body)

    def revoke(self, place: Place, grant: Ref) -> None:
        """Take a right away: a grant, its id, or the name, address or id of whom it is to.

        Raises:
            LastOwner: it is the last lasting owner's.
        """
        found = find_grant(self.grants(place), grant) if isinstance(grant, str) else None
        grant_id = found.id if found else known_id(grant, "grant")
        self._api.delete(f"{_path(place)}/grants/{grant_id}")

    def grantee(self, ref: str) -> Grantee:
        """Return whom an address, an id or a name means: whoever has that address, a person, or a group.

        Raises:
            NotFound: nobody whom one may know of.
            AmbiguousName: several; lists them with their ids.
        """
        if "@" in ref:
            return Grantee(kind=GranteeKind.email, id=None, name=ref)
        if is_id(ref):
            return self._of_id(ref)
        people = [_to(GranteeKind.person, row.id, row.name) for row in People(self._api).list(text=ref, active=True)]
        groups = [_to(GranteeKind.group, row.id, row.name) for row in Groups(self._api).list(name=ref)]
        return the_one("person or group", ref, [*people, *groups], name=lambda row: row.name, label=_label)

    def _of_id(self, ref: str) -> Grantee:
        try:
            person = People(self._api).get(ref)
        except NotFound:
            group = Groups(self._api).get(ref)
            return _to(GranteeKind.group, group.id, group.name)
        return _to(GranteeKind.person, person.id, person.name)


def find_grant(grants: Iterator[GrantRead], ref: str) -> GrantRead:
    """Return the grant that is to somebody, by their name, address or id.

    Raises:
        NotFound: none is.
        AmbiguousName: several are to somebody of that name.
    """
    rows = [*grants]
    by_id = [row for row in rows if ref in (str(row.to.id), str(row.id))]
    return the_one(
        "grant to", ref, by_id or rows, name=lambda row: ref if by_id else row.to.name, label=lambda row: _label(row.to)
    )


def _path(place: Place) -> str:
    return f"/projects/{place.id}" if isinstance(place, ProjectRead) else f"/missions/{place.id}"


def _to(kind: GranteeKind, ref: uuid.UUID, name: str) -> Grantee:
    return Grantee(kind=kind, id=ref, name=name)


def _label(to: Grantee) -> str:
    return f"{to.kind.value} {to.name} ({to.id})" if to.id else to.name
