"""What a route that signs a browser in works with, and how it ends: a new session in the answer's cookie."""

import asyncio
import uuid
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request, Response

from kleinkram.contract.accounts import BrowserSignedIn
from kleinkram.contract.errors import NotFound
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.auth.codes import look_at_code
from kleinkram.server.auth.cookies import browser_of, keep_session
from kleinkram.server.auth.passwords import Passwords
from kleinkram.server.auth.providers import Providers
from kleinkram.server.auth.sessions import begin_session
from kleinkram.server.db import Connection, Database
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, CurrentSettings
from kleinkram.server.http.rate_limit import Count, enforce_limits, reserve_slot, subscriber_network
from kleinkram.server.settings import Settings

# From so many addresses at once may an account be tried as often as each may try, before tries take turns.
_ADDRESSES = 3


@dataclass(frozen=True)
class Door:
    """One request at the door: who asks, by which browser, and what the process has to answer with."""

    asker: Actor
    request: Request
    database: Database
    settings: Settings

    @property
    def passwords(self) -> Passwords:
        """The process's turns at hashing."""
        passwords: Passwords = self.request.app.state.passwords
        return passwords

    @property
    def providers(self) -> Providers:
        """The process's providers of identities."""
        providers: Providers = self.request.app.state.providers
        return providers

    async def count_try(self, account: str | None = None) -> None:
        """Count a try to sign in: for the address that it comes from, and for the account, whether there is one or not.

        One address is refused; an account that is tried from several is slowed down, so that none of them locks it.

        Raises:
            RateLimited: there were too many within a minute.
        """
        most = self.settings.sign_ins_per_minute
        if self.asker.address:
            await enforce_limits(self.database, Count("sign-ins", subscriber_network(self.asker.address), most))
        if account:
            await asyncio.sleep(
                await reserve_slot(self.database, Count("sign-ins", account.lower(), _ADDRESSES * most))
            )

    async def hash(self, password: str, *, code: str, about: tuple[str | None, ...] = ()) -> str:
        """Hash a new password, which takes a good code; that stays good.

        Raises:
            CodeGone: the code is not good.
            InvalidRequest: the password is known, or easy to guess.
            SlowDown: too many wait already.
        """
        async with self.database.begin() as db:
            whose = await look_at_code(db, code)
        return await self.hash_new(password, field="password", about=(whose.name, whose.email, *about))

    async def hash_new(self, password: str, *, field: str, about: tuple[str | None, ...]) -> str:
        """Hash a password that somebody chooses.

        Raises:
            InvalidRequest: it is known, or easy to guess.
            SlowDown: too many wait already.
        """
        return await self.passwords.hash_new(password, field=field, about=(*about, self.settings.lab_name))

    async def let_in(self, db: Connection, response: Response, *, person_id: uuid.UUID, way: str) -> BrowserSignedIn:
        """Sign the browser in, as part of the caller's transaction.

        Raises:
            SignInRefused: that person left.
        """
        browser = browser_of(self.request, self.settings)
        begun = await begin_session(
            db, self.asker, person_id=person_id, way=way, browser=browser, lasts_s=self.settings.session_s
        )
        keep_session(response, self.settings, begun.secret)
        return BrowserSignedIn(person=PersonRef(id=person_id, name=begun.actor.name))

    def see_that_passwords_are_taken(self) -> None:
        """See that this server has local accounts.

        Raises:
            NotFound: it does not.
        """
        if not self.settings.local_accounts:
            raise NotFound(noun="way to sign in", ref="password")


async def _door(request: Request, database: CurrentDatabase, settings: CurrentSettings, actor: CurrentActor) -> Door:
    return Door(actor, request, database, settings)


CurrentDoor = Annotated[Door, Depends(_door)]
