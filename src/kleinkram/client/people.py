"""People, groups, and their access to projects and missions."""

import datetime
import uuid
from collections.abc import Iterator

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import Listing, Ref, checked, known_id, pages, resolve_one
from kleinkram.contract.access import (
    AccessRead,
    GrantCreate,
    Grantee,
    GranteeKind,
    GrantRead,
    GroupCreate,
    GroupRead,
    GroupUpdate,
    MemberRead,
    MemberSet,
    Right,
)
from kleinkram.contract.accounts import InvitationCreate, OneTimeLink
from kleinkram.contract.errors import NotFound
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.names import is_id
from kleinkram.contract.people import Departure, PersonRead
from kleinkram.contract.projects import ProjectRead


class People:
    """`client.people`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(
        self, *, text: str | None = None, active: bool | None = None, limit: int | None = None
    ) -> Listing[PersonRead]:
        """Yield the people one may know of, by name; `text` is found in names, and in addresses that one may know."""
        return pages(self._api, "/people", PersonRead, query_of(None, text=text, active=active), limit=limit)

    def get(self, ref: Ref) -> PersonRead:
        """Return the person with this id, address or name; wherever a person is meant, any of these will do.

        Raises:
            NotFound: there is nobody whom one may know of.
            AmbiguousName: several have that name.
        """
        if (person_id := known_id(ref, "person")) is not None:
            return self._api.get(f"/people/{person_id}", PersonRead)
        name = str(ref)
        rows = [*self.list(text=name)]
        by_address = [row for row in rows if name.lower() in [email.lower() for email in row.emails]]
        return resolve_one(
            "person", name, by_address or rows, name=lambda row: name if by_address else row.name, label=person_label
        )

    def id_of(self, ref: Ref) -> uuid.UUID:
        """Return the id of a person; one that is known is not asked for.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        return known_id(ref, "person") or self.get(ref).id

    def make_admin(self, person: Ref) -> PersonRead:
        """Make somebody an admin, without an end. For admins."""
        return self._api.send("POST", f"/people/{self.id_of(person)}/admin", PersonRead)

    def unmake_admin(self, person: Ref) -> PersonRead:
        """Take the power of an admin from somebody. For admins.

        Raises:
            LastAdmin: nobody else has it without an end.
        """
        return self._api.send("DELETE", f"/people/{self.id_of(person)}/admin", PersonRead)

    def deactivate(self, person: Ref) -> Departure:
        """End somebody's sessions, tokens and links at once, and return what ended. For admins.

        Projects that nobody else owns go to the admins; their name stays in the record.

        Raises:
            LastAdmin: they are the last lasting admin.
        """
        return self._api.send("POST", f"/people/{self.id_of(person)}/deactivate", Departure)

    def reactivate(self, person: Ref) -> PersonRead:
        """Let somebody who left sign in again, with the groups and rights they have. For admins."""
        return self._api.send("POST", f"/people/{self.id_of(person)}/reactivate", PersonRead)

    def invite(self, email: str, *, name: str | None = None) -> OneTimeLink:
        """Return a link by which somebody gets an account with this address, once; nothing is mailed. For admins.

        Who uses it is taken to have the address: see that it reaches nobody else. An earlier one is good no more.

        Raises:
            NameTaken: there is an account with it.
        """
        body = checked(InvitationCreate, "The invitation", email=email, name=name)
        return self._api.send("POST", "/people/invitations", OneTimeLink, body)

    def reset_password(self, person: Ref) -> OneTimeLink:
        """Return a link by which somebody chooses a new password, once; nothing is mailed. For admins."""
        return self._api.send("POST", f"/people/{self.id_of(person)}/reset", OneTimeLink)

    def reset_totp(self, person: Ref) -> None:
        """Take somebody's second factor away, who lost their device and their recovery codes. For admins.

        Raises:
            NotFound: they have none.
        """
        self._api.delete(f"/people/{self.id_of(person)}/totp")


def person_label(person: PersonRead) -> str:
    """Return a person's name and id."""
    return f"{person.name} ({person.id})"


class Groups:
    """`client.groups`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(self, *, name: str | None = None, limit: int | None = None) -> Listing[GroupRead]:
        """Yield the groups that one is in, by name; admins see all. `name` may be a glob."""
        return pages(self._api, "/groups", GroupRead, query_of(None, name=name), limit=limit)

    def get(self, ref: Ref) -> GroupRead:
        """Return the group with this id or name. Wherever a group is meant, any of these will do, or the group itself.

        Raises:
            NotFound: there is none that one may see.
            AmbiguousName: a glob matches several.
        """
        if (group_id := known_id(ref, "group")) is not None:
            return self._api.get(f"/groups/{group_id}", GroupRead)
        name = str(ref)
        return resolve_one("group", name, self.list(name=name), name=lambda row: row.name, label=group_label)

    def id_of(self, ref: Ref) -> uuid.UUID:
        """Return the id of a group; one that is known is not asked for.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        return known_id(ref, "group") or self.get(ref).id

    def create(self, name: str) -> GroupRead:
        """Make a group, with oneself as first member and editor.

        Raises:
            NameTaken: there is one of that name, seen or not.
            Forbidden: the server lets others make groups.
            InvalidInput: the name is not usable.
        """
        return self._api.send("POST", "/groups", GroupRead, checked(GroupCreate, "The group", name=name))

    def rename(self, group: Ref, name: str, *, if_match: str | None = None) -> GroupRead:
        """Rename a group. For its editors.

        With `if_match`, the `etag` of what was looked at, a change is refused where somebody else came first.

        Raises:
            NameTaken, InvalidInput: as in `create`.
            GroupFixed: its name is in the server's settings.
            EditConflict: it is of another ETag by now.
        """
        body = checked(GroupUpdate, "The group", name=name)
        return self._api.patch(f"/groups/{self.id_of(group)}", GroupRead, body, etag=if_match)

    def delete(self, group: Ref) -> None:
        """Delete a group, and with it what was granted to it. For its editors.

        Raises:
            LastOwner: a project would be left without an owner.
            GroupFixed: it is one that the server's settings ask for.
        """
        self._api.delete(f"/groups/{self.id_of(group)}")

    def members(self, group: Ref) -> Listing[MemberRead]:
        """Yield the people in a group, by name; addresses and past members are for its editors."""
        return pages(self._api, f"/groups/{self.id_of(group)}/members", MemberRead, [])

    def set_member(
        self,
        group: Ref,
        person: Ref,
        *,
        is_editor: bool = False,
        expires_at: datetime.datetime | None = None,
        if_match: str | None = None,
    ) -> MemberRead:
        """Put somebody into a group, or change how and until when they are in it. For its editors.

        With `if_match`, the `etag` of what was looked at, a change is refused where somebody else came first.

        Raises:
            NotFound: there is nobody of that name or id whom one may know of; with `if_match`, in the group.
            InvalidInput: the time has no zone.
            EditConflict: the membership is of another ETag by now.
        """
        body = checked(MemberSet, "The membership", is_editor=is_editor, expires_at=expires_at)
        return self._api.send("PUT", self._member(group, person), MemberRead, body, etag=if_match)

    def remove_member(self, group: Ref, person: Ref) -> None:
        """Take somebody out of a group, as its editor; or leave it oneself.

        Raises:
            LastOwner: a project would be left without an owner.
        """
        self._api.delete(self._member(group, person))

    def _member(self, group: Ref, person: Ref) -> str:
        return f"/groups/{self.id_of(group)}/members/{People(self._api).id_of(person)}"


def group_label(group: GroupRead) -> str:
    """Return a group's name and id."""
    return f"{group.name} ({group.id})"


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
        grantee_fields = {"email": to.name} if to.kind is GranteeKind.email else {f"{to.kind.value}_id": to.id}
        body = checked(GrantCreate, "The grant", **grantee_fields, right=right, expires_at=expires_at)
        return self._api.send("POST", f"{_path(place)}/grants", GrantRead, body)

    def revoke(self, place: Place, grant: Ref) -> None:
        """Take a right away: a grant, its id, or the name, address or id of whom it is to.

        Raises:
            LastOwner: it is the last lasting owner's.
        """
        existing = find_grant(self.grants(place), grant) if isinstance(grant, str) else None
        grant_id = existing.id if existing else known_id(grant, "grant")
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
        return resolve_one("person or group", ref, [*people, *groups], name=lambda row: row.name, label=_grantee_label)

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
    return resolve_one(
        "grant to",
        ref,
        by_id or rows,
        name=lambda row: ref if by_id else row.to.name,
        label=lambda row: _grantee_label(row.to),
    )


def _path(place: Place) -> str:
    return f"/projects/{place.id}" if isinstance(place, ProjectRead) else f"/missions/{place.id}"


def _to(kind: GranteeKind, ref: uuid.UUID, name: str) -> Grantee:
    return Grantee(kind=kind, id=ref, name=name)


def _grantee_label(to: Grantee) -> str:
    return f"{to.kind.value} {to.name} ({to.id})" if to.id else to.name
