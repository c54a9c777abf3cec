"""Oneself, as the server knows one: for programs that want to say who they work for, or to sign out."""

import uuid

from pydantic import RootModel

from kleinkram.client._http import Api
from kleinkram.client._paging import Listing, pages
from kleinkram.contract.accounts import AccountRead, IdentityRead, OneTimeLink
from kleinkram.contract.signing_in import MeRead, SessionRead


class _Identities(RootModel[list[IdentityRead]]):
    """The answer of a list that is never long."""


class Me:
    """`client.me`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def get(self) -> MeRead:
        """Return whose the token in use is, and what it is good for.

        Raises:
            NotAuthenticated: it is unknown, expired or revoked.
        """
        return self._api.get("/me", MeRead)

    def account(self) -> AccountRead:
        """Return one's own account: name, addresses, affiliations, and whether there is a password."""
        return self._api.get("/me/account", AccountRead)

    def identities(self) -> list[IdentityRead]:
        """Return under which providers' word one signs in."""
        return self._api.get("/me/identities", _Identities).root

    def unlink_identity(self, identity_id: uuid.UUID) -> None:
        """Take a provider's word for oneself no more. Sessions, tokens and addresses stay.

        Raises:
            NotFound: none of one's own has that id.
            LastSignInMethod: without it there would be no way to sign in.
        """
        self._api.delete(f"/me/identities/{identity_id}")

    def sign_out(self) -> None:
        """Revoke the token in use: from the next request on it is good for nothing. Those made with it stay.

        Raises:
            NotAuthenticated: it already was.
        """
        self._api.delete(f"/tokens/{self.get().credential.id}", [("made", "kept")])

    def sessions(self) -> Listing[SessionRead]:
        """Yield the browsers that one is signed in with."""
        return pages(self._api, "/me/sessions", SessionRead, [])

    def end_session(self, session_id: uuid.UUID) -> None:
        """Sign one browser out.

        Raises:
            NotFound: none of one's own has that id.
        """
        self._api.delete(f"/me/sessions/{session_id}")

    def end_sessions(self) -> None:
        """Sign every browser out. Tokens stay as they are."""
        self._api.delete("/me/sessions")

    def owner_link(self) -> OneTimeLink:
        """Return a link that signs a browser in, once, as the owner of `klein up`. One made before is good no more.

        Raises:
            Forbidden: the token in use is not the owner's.
        """
        return self._api.understood(OneTimeLink, "POST /auth/owner-link", self._api.post_empty("/auth/owner-link"))
