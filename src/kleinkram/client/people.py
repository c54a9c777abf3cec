"""People, for programs: those one may know of."""

import uuid

from kleinkram.client._http import Api, query_of
from kleinkram.client._paging import Listing, pages
from kleinkram.client.checking import checked
from kleinkram.client.references import Ref, known_id, the_one
from kleinkram.contract.accounts import InvitationCreate, OneTimeLink
from kleinkram.contract.people import Departure, PersonRead


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
        said = str(ref)
        rows = [*self.list(text=said)]
        by_address = [row for row in rows if said.lower() in [email.lower() for email in row.emails]]
        return the_one(
            "person", said, by_address or rows, name=lambda row: said if by_address else row.name, label=_label
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
        wanted = checked(InvitationCreate, "The invitation", email=email, name=name)
        return self._api.send("POST", "/people/invitations", OneTimeLink, wanted)

    def reset_password(self, person: Ref) -> OneTimeLink:
        """Return a link by which somebody chooses a new password, once; nothing is mailed. For admins."""
        return self._api.send("POST", f"/people/{self.id_of(person)}/reset", OneTimeLink)

    def reset_totp(self, person: Ref) -> None:
        """Take somebody's second factor away, who lost their device and their recovery codes. For admins.

        Raises:
            NotFound: they have none.
        """
        self._api.delete(f"/people/{self.id_of(person)}/totp")


def _label(person: PersonRead) -> str:
    return f"{person.name} ({person.id})"
