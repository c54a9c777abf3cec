"""Groups of people, for programs."""

import datetime
import uuid

from kleinkram.client._http import Api, query_of
from kleinkram.client._paging import Listing, pages
from kleinkram.client.checking import checked
from kleinkram.client.people import People
from kleinkram.client.references import Ref, known_id, the_one
from kleinkram.contract.groups import GroupCreate, GroupRead, GroupUpdate, MemberRead, MemberSet


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
        return the_one("group", name, self.list(name=name), name=lambda row: row.name, label=_label)

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


def _label(group: GroupRead) -> str:
    return f"{group.name} ({group.id})"
