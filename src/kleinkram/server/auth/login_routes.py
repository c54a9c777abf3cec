"""Logins of programs over HTTP, and oneself: `klein login`, `klein whoami`, the browsers that one is signed in with."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.accounts import (
    AccountRead,
    DeviceDecision,
    DeviceRead,
    IdentityRead,
    InvitationCreate,
    LoopbackApproval,
    LoopbackApproved,
    OneTimeLink,
    RecoveryCodes,
    TotpConfirm,
    TotpEnrolment,
)
from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.contract.signing_in import (
    CliExchange,
    DeviceBegin,
    DeviceCode,
    DeviceExchange,
    MeRead,
    SessionRead,
    SignedIn,
)
from kleinkram.server.auth import local, logins, me, own, sessions, totp
from kleinkram.server.auth.door import CurrentDoor
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, CurrentSettings, Transaction
from kleinkram.server.paging import PageRequest

login_router = APIRouter(prefix="/api/v1/auth", tags=["signing in"])
me_router = APIRouter(prefix="/api/v1/me", tags=["me"])
people_router = APIRouter(prefix="/api/v1/people", tags=["people"])


class SessionListQuery(BaseModel):
    """The query of a list of sessions."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    limit: PageSize = 100
    cursor: Cursor | None = None


@login_router.post("/cli/approve", operation_id="approve_cli_login")
async def approve_cli_login(wanted: LoopbackApproval, db: Transaction, actor: CurrentActor) -> LoopbackApproved:
    """Agree that a program on the browser's machine gets a token."""
    return await logins.approve_loopback(db, actor, wanted=wanted)


@login_router.post("/cli/token", operation_id="exchange_cli_code")
async def exchange_cli_code(brought: CliExchange, door: CurrentDoor) -> SignedIn:
    """Exchange what the browser brought to the loopback for a token."""
    await door.count_try()
    async with door.database.begin() as db:
        return await logins.exchange_loopback(db, door.asker, brought=brought, settings=door.settings)


@login_router.post("/device", operation_id="begin_device_login")
async def begin_device_login(wanted: DeviceBegin, door: CurrentDoor) -> DeviceCode:
    """Begin a login by a code that is typed on another machine."""
    await door.count_try()
    async with door.database.begin() as db:
        return await logins.begin_device(db, door.asker, client=wanted.client, settings=door.settings)


@login_router.post("/device/token", operation_id="exchange_device_code")
async def exchange_device_code(
    brought: DeviceExchange, database: CurrentDatabase, actor: CurrentActor, settings: CurrentSettings
) -> SignedIn:
    """Exchange a device's secret for a token, once its code was typed."""
    return await logins.exchange_device(database, actor, device_code=brought.device_code, settings=settings)


@login_router.post("/device/look", operation_id="look_at_device_login")
async def look_at_device_login(shown: DeviceDecision, door: CurrentDoor) -> DeviceRead:
    """Say who shows a code."""
    await door.count_try(str(door.asker.person_id))
    async with door.database.begin() as db:
        return await logins.look_at_device(db, shown.user_code)


@login_router.post("/device/approve", operation_id="approve_device_login")
async def approve_device_login(shown: DeviceDecision, door: CurrentDoor) -> DeviceRead:
    """Agree that the program that shows a code gets a token."""
    await door.count_try(str(door.asker.person_id))
    async with door.database.begin() as db:
        return await logins.approve_device(db, door.asker, shown.user_code)


@login_router.post("/device/deny", operation_id="deny_device_login")
async def deny_device_login(shown: DeviceDecision, door: CurrentDoor) -> DeviceRead:
    """Disagree."""
    await door.count_try(str(door.asker.person_id))
    async with door.database.begin() as db:
        return await logins.deny_device(db, door.asker, shown.user_code)


@me_router.get("", operation_id="get_me")
async def get_me(db: Transaction, actor: CurrentActor) -> MeRead:
    """Say who asks, and what their credential is good for."""
    return await me.get_me(db, actor)


@me_router.get("/sessions", operation_id="list_sessions")
async def list_sessions(
    query: Annotated[SessionListQuery, Query()], db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> Page[SessionRead]:
    """List the browsers that one is signed in with, latest first."""
    page = PageRequest(query.limit, query.cursor)
    return await sessions.list_sessions(db, actor, settings=settings, page=page)


@me_router.delete("/sessions", operation_id="end_all_sessions", status_code=204)
async def end_all_sessions(db: Transaction, actor: CurrentActor) -> None:
    """Sign all of one's browsers out, this one too. Tokens stay as they are."""
    await sessions.end_sessions(db, actor)


@me_router.delete("/sessions/{session_id}", operation_id="end_session", status_code=204)
async def end_session(session_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Sign one of one's browsers out."""
    await sessions.end_session(db, actor, session_id=session_id)


@me_router.get("/account", operation_id="get_account")
async def get_account(db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> AccountRead:
    """Return one's own account: name, addresses, affiliations, and whether there is a password."""
    return await own.get_account(db, actor, settings=settings)


@me_router.get("/identities", operation_id="list_identities")
async def list_identities(db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> list[IdentityRead]:
    """List under whose word one signs in."""
    return await own.list_identities(db, actor, settings=settings)


@me_router.delete("/identities/{identity_id}", operation_id="unlink_identity", status_code=204)
async def unlink_identity(
    identity_id: uuid.UUID, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> None:
    """Take a provider's word for oneself no more. The last way to sign in stays; nothing else ends."""
    await own.unlink_identity(db, actor, identity_id=identity_id, settings=settings)


@me_router.post("/totp", operation_id="begin_totp", status_code=201)
async def begin_totp(db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> TotpEnrolment:
    """Make a secret for an authenticator app; it is in use once a code of it was confirmed."""
    return await totp.begin_totp(db, actor, settings=settings)


@me_router.post("/totp/confirm", operation_id="confirm_totp")
async def confirm_totp(given: TotpConfirm, door: CurrentDoor) -> RecoveryCodes:
    """Take a second factor into use; one's other browsers are signed out. The recovery codes are shown this once."""
    await door.count_try(str(door.asker.person_id))
    return await totp.confirm_totp(door.database, door.asker, code=given.code)


@me_router.post("/totp/recovery-codes", operation_id="renew_recovery_codes")
async def renew_recovery_codes(db: Transaction, actor: CurrentActor) -> RecoveryCodes:
    """Make new recovery codes in place of those from before."""
    return await totp.renew_recovery_codes(db, actor)


@me_router.delete("/totp", operation_id="disable_totp", status_code=204)
async def disable_totp(db: Transaction, actor: CurrentActor) -> None:
    """Sign in with the password alone from now on."""
    await totp.disable_totp(db, actor)


@people_router.delete("/{person_id}/totp", operation_id="reset_totp", status_code=204)
async def reset_totp(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Take somebody's second factor away, who lost their device and their recovery codes."""
    await totp.reset_totp(db, actor, person_id=person_id)


@people_router.post("/invitations", operation_id="invite_person", status_code=201)
async def invite_person(
    wanted: InvitationCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> OneTimeLink:
    """Make a link by which somebody gets an account; whoever asks gives it to them."""
    return await local.make_invitation(db, actor, wanted=wanted, settings=settings)


@people_router.post("/{person_id}/reset", operation_id="create_reset_link", status_code=201)
async def create_reset_link(
    person_id: uuid.UUID, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> OneTimeLink:
    """Make a link by which somebody chooses a new password; whoever asks gives it to them."""
    return await local.make_reset(db, actor, person_id=person_id, settings=settings)
