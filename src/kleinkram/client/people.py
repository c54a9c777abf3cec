"""People, groups, and their access to projects and missions. `if_match` is the ETag that must still hold."""

import datetime
import time
from collections.abc import Iterator

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, Listing, NamedResource, Ref, checked, known_id, pages, resolve_one
from kleinkram.contract import access
from kleinkram.contract.accounts import InvitationCreate, OneTimeLink
from kleinkram.contract.errors import NotFound
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.names import is_id
from kleinkram.contract.people import Departure, Erasure, PersonalData, PersonErase, PersonRead
from kleinkram.contract.projects import ProjectRead

_POLL_S = 0.5


class People(NamedResource[PersonRead]):
    """`client.people`."""

    _resource_type = "person"

    def list(
        self, *, text: str | None = None, active: bool | None = None, limit: int | None = None
    ) -> Listing[PersonRead]:
        """Yield the people one may see, by name; `text` is found in names, and in addresses that one may see."""
        return pages(self._api, "/people", PersonRead, query_of(None, text=text, active=active), limit=limit)

    def get(self, ref: Ref) -> PersonRead:
        """Return the person with this id, address or name; wherever a person is meant, any of these will do."""
        if (person_id := known_id(ref, "person")) is not None:
            return self._api.get(f"/people/{person_id}", PersonRead)
        name = str(ref)
        rows = [*self.list(text=name)]
        by_address = [row for row in rows if name.lower() in [email.lower() for email in row.emails]]
        return resolve_one(
            "person", name, by_address or rows, name=lambda row: name if by_address else row.name, label=person_label
        )

    def make_admin(self, person: Ref) -> PersonRead:
        """Make a person an admin, without an end. For admins."""
        return self._api.send("POST", f"/people/{self.id_of(person)}/admin", PersonRead)

    def unmake_admin(self, person: Ref) -> PersonRead:
        """Take the admin role from a person; LastAdmin for the last lasting one. For admins."""
        return self._api.send("DELETE", f"/people/{self.id_of(person)}/admin", PersonRead)

    def deactivate(self, person: Ref) -> Departure:
        """End the sessions, tokens and links of a person at once, and return what ended. For admins.

        Their projects without another owner go to the admins. The last lasting admin cannot be deactivated (LastAdmin).
        """
        return self._api.send("POST", f"/people/{self.id_of(person)}/deactivate", Departure)

    def reactivate(self, person: Ref) -> PersonRead:
        """Let a person who left sign in again, with the groups and rights they have. For admins."""
        return self._api.send("POST", f"/people/{self.id_of(person)}/reactivate", PersonRead)

    def erase(self, person: Ref, *, confirmation: str) -> Erasure:
        """Erase a person irrevocably: a pseudonym replaces their name everywhere, and what they did stays on record.

        `confirmation` is their name. Texts that mention them are returned, and stay as they are. A job redacts the
        audit log: `erasure` returns when. For a person who was erased before, it only returns that. For admins.

        Raises:
            InvalidRequest: `confirmation` is not their name.
            LastAdmin: they are the last lasting admin.
            SignInTooOld: one must have signed in recently.
        """
        body = checked(PersonErase, "The confirmation", confirmation=confirmation)
        return self._api.send("POST", f"/people/{self.id_of(person)}/erase", Erasure, body)

    def erasure(self, person: Ref, *, wait_s: float = 0.0) -> Erasure:
        """Return how far the erasure of a person is; wait at most `wait_s` for the audit log to be redacted."""
        path, end = f"/people/{self.id_of(person)}/erasure", time.monotonic() + wait_s
        while True:
            erasure = self._api.get(path, Erasure)
            if erasure.audit_events is not None or time.monotonic() >= end:
                return erasure
            time.sleep(_POLL_S)

    def export(self, person: Ref) -> Iterator[PersonalData]:
        """Yield all that the server keeps of a person, without secrets, as a stream of records.

        For oneself with a credential of scope admin; admins export everybody's. Raises ServerUnreachable where the
        stream breaks off.
        """
        return self._api.stream(f"/people/{self.id_of(person)}/export", PersonalData)

    def invite(self, email: str, *, name: str | None = None) -> OneTimeLink:
        """Return a link that creates an account with this address, once; no e-mail is sent. For admins.

        The link verifies the address: give it to this person only. It replaces an earlier one. NameTaken: there is an
        account.
        """
        body = checked(InvitationCreate, "The invitation", email=email, name=name)
        return self._api.send("POST", "/people/invitations", OneTimeLink, body)

    def reset_password(self, person: Ref) -> OneTimeLink:
        """Return a link that sets a new password, once; no e-mail is sent. For admins."""
        return self._api.send("POST", f"/people/{self.id_of(person)}/reset", OneTimeLink)

    def reset_totp(self, person: Ref) -> None:
        """Remove the second factor of a person who lost their device and recovery codes. For admins."""
        self._api.delete(f"/people/{self.id_of(person)}/totp")


def person_label(person: PersonRead) -> str:
    """Return a person's name and id."""
    return f"{person.name} ({person.id})"


class Groups(NamedResource[access.GroupRead]):
    """`client.groups`."""

    _resource_type = "group"

    def list(self, *, name: str | None = None, limit: int | None = None) -> Listing[access.GroupRead]:
        """Yield the groups that one is in, by name; admins see all. `name` may be a glob."""
        return pages(self._api, "/groups", access.GroupRead, query_of(None, name=name), limit=limit)

    def get(self, ref: Ref) -> access.GroupRead:
        """Return the group with this id or name; raise AmbiguousName for a glob that matches several."""
        if (group_id := known_id(ref, "group")) is not None:
            return self._api.get(f"/groups/{group_id}", access.GroupRead)
        name = str(ref)
        return resolve_one("group", name, self.list(name=name), name=lambda row: row.name, label=group_label)

    def create(self, name: str) -> access.GroupRead:
        """Create a group, with yourself as first member and editor.

        Raises:
            NameTaken: there is one of that name, visible or not.
            Forbidden: the server's settings do not allow it.
        """
        return self._api.send("POST", "/groups", access.GroupRead, checked(access.GroupCreate, "The group", name=name))

    def rename(self, group: Ref, name: str, *, if_match: str | None = None) -> access.GroupRead:
        """Rename a group; GroupFixed where the server's settings name it. For its editors."""
        body = checked(access.GroupUpdate, "The group", name=name)
        return self._api.patch(f"/groups/{self.id_of(group)}", access.GroupRead, body, etag=if_match)

    def delete(self, group: Ref) -> None:
        """Delete a group, and what was granted to it. For its editors.

        Raises:
            LastOwner: a project would be left without an owner.
            GroupFixed: the server's settings name it.
        """
        self._api.delete(f"/groups/{self.id_of(group)}")

    def members(self, group: Ref) -> Listing[access.MemberRead]:
        """Yield the people in a group, by name; addresses and past members are for its editors."""
        return pages(self._api, f"/groups/{self.id_of(group)}/members", access.MemberRead, [])

    def set_member(
        self,
        group: Ref,
        person: Ref,
        *,
        is_editor: bool = False,
        expires_at: datetime.datetime | None = None,
        if_match: str | None = None,
    ) -> access.MemberRead:
        """Add a person to a group, or change their role and the end of their membership. For its editors."""
        body = checked(access.MemberSet, "The membership", is_editor=is_editor, expires_at=expires_at)
        return self._api.send("PUT", self._member(group, person), access.MemberRead, body, etag=if_match)

    def remove_member(self, group: Ref, person: Ref) -> None:
        """Remove a person from a group, as its editor; or leave it. LastOwner: a project would have no owner."""
        self._api.delete(self._member(group, person))

    def _member(self, group: Ref, person: Ref) -> str:
        return f"/groups/{self.id_of(group)}/members/{People(self._api).id_of(person)}"


def group_label(group: access.GroupRead) -> str:
    """Return a group's name and id."""
    return f"{group.name} ({group.id})"


AccessResource = ProjectRead | MissionRead


class Access(ApiResource):
    """`client.access`. A resource is a project or a mission, as `client.projects` and `client.missions` return them."""

    def ways(self, resource: AccessResource) -> Listing[access.AccessRead]:
        """Yield who has which right on a resource now, and through what; without WRITE there, only one's own rights."""
        return pages(self._api, f"{_path(resource)}/access", access.AccessRead, [])

    def grants(self, resource: AccessResource) -> Listing[access.GrantRead]:
        """Yield the grants on a resource itself, by the name of the grantee, including expired ones."""
        return pages(self._api, f"{_path(resource)}/grants", access.GrantRead, [])

    def grant(
        self,
        resource: AccessResource,
        to: access.Grantee | str,
        right: access.Right,
        *,
        expires_at: datetime.datetime | None = None,
    ) -> access.GrantRead:
        """Grant a right; it replaces the right that the grantee was granted there before.

        `to` is a result of `grantee`, or what that takes: an address, a name or an id.

        Raises:
            RightExceeded: it is more, or for longer, than one holds.
            LastOwner: it would replace the last lasting owner.
        """
        to = self.grantee(to) if isinstance(to, str) else to
        grantee_fields = {"email": to.name} if to.kind is access.GranteeKind.email else {f"{to.kind.value}_id": to.id}
        body = checked(access.GrantCreate, "The grant", **grantee_fields, right=right, expires_at=expires_at)
        return self._api.send("POST", f"{_path(resource)}/grants", access.GrantRead, body)

    def revoke(self, resource: AccessResource, grant: Ref) -> None:
        """Revoke a grant, by itself, its id, or the name, address or id of the grantee; LastOwner for the last."""
        existing = find_grant(self.grants(resource), grant) if isinstance(grant, str) else None
        grant_id = existing.id if existing else known_id(grant, "grant")
        self._api.delete(f"{_path(resource)}/grants/{grant_id}")

    def grantee(self, ref: str) -> access.Grantee:
        """Return the grantee that an address, an id or a name means: that address, a person, or a group.

        Raises:
            NotFound: there is none that this account may see.
            AmbiguousName: there are several; lists them with their ids.
        """
        if "@" in ref:
            return access.Grantee(kind=access.GranteeKind.email, id=None, name=ref)
        if is_id(ref):
            try:
                person = People(self._api).get(ref)
            except NotFound:
                group = Groups(self._api).get(ref)
                return access.Grantee(kind=access.GranteeKind.group, id=group.id, name=group.name)
            return access.Grantee(kind=access.GranteeKind.person, id=person.id, name=person.name)
        people, groups = People(self._api).list(text=ref, active=True), Groups(self._api).list(name=ref)
        candidates = [access.Grantee(kind=access.GranteeKind.person, id=row.id, name=row.name) for row in people]
        candidates += [access.Grantee(kind=access.GranteeKind.group, id=row.id, name=row.name) for row in groups]
        return resolve_one("person or group", ref, candidates, name=lambda row: row.name, label=_grantee_label)


def find_grant(grants: Iterator[access.GrantRead], ref: str) -> access.GrantRead:
    """Return the grant of a grantee, by their name, address or id."""
    rows = [*grants]
    by_id = [row for row in rows if ref in (str(row.to.id), str(row.id))]
    return resolve_one(
        "grant to",
        ref,
        by_id or rows,
        name=lambda row: ref if by_id else row.to.name,
        label=lambda row: _grantee_label(row.to),
    )


def _path(resource: AccessResource) -> str:
    return f"/projects/{resource.id}" if isinstance(resource, ProjectRead) else f"/missions/{resource.id}"


def _grantee_label(to: access.Grantee) -> str:
    return f"{to.kind.value} {to.name} ({to.id})" if to.id else to.name
