"""Routes of signing in, one's own account, and logins of programs.

Routes that give a browser a session accept requests only from pages of this server.
"""

import uuid
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response

from kleinkram.contract import accounts
from kleinkram.contract.base import Page
from kleinkram.server.auth import (
    account,
    bootstrap,
    cli_logins,
    local_accounts,
    one_time_codes,
    second_factor,
    sessions,
)
from kleinkram.server.auth.dependencies import CurrentSignIn, SignInContext, bind_browser, delete_session_cookie
from kleinkram.server.auth.provider_accounts import AuthorizationRequest, store_request
from kleinkram.server.http.dependencies import (
    CurrentActor,
    CurrentDatabase,
    CurrentSettings,
    Transaction,
    require_same_origin,
)
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageQuery
from kleinkram.server.tables.sign_in import CodePurpose

router = APIRouter(prefix="/api/v1/auth", tags=["signing in"], responses=FAILURE_RESPONSES)
me_router = APIRouter(prefix="/api/v1/me", tags=["me"], responses=FAILURE_RESPONSES)
people_router = APIRouter(prefix="/api/v1/people", tags=["people"], responses=FAILURE_RESPONSES)
# Also without a cookie: another site's page must not sign a person in as somebody else.
_SAME_ORIGIN = [Depends(require_same_origin)]


@router.get("/methods", operation_id="list_sign_in_methods")
async def list_sign_in_methods(db: Transaction, settings: CurrentSettings) -> accounts.SignInMethods:
    """List the methods with which people sign in to this server."""
    providers = [accounts.ProviderRef(name=provider.name, title=provider.title) for provider in settings.oidc_providers]
    has_admin = await bootstrap.has_admin(db)
    return accounts.SignInMethods(password=settings.local_accounts, providers=providers, bootstrap=not has_admin)


@router.post("/password", operation_id="sign_in_by_password", dependencies=_SAME_ORIGIN)
async def sign_in_by_password(
    sign_in: accounts.PasswordSignIn, context: CurrentSignIn, response: Response
) -> accounts.BrowserSignedIn:
    """Sign a browser in with a local account."""
    context.require_local_accounts()
    await context.count_attempt(sign_in.email)
    verified = await local_accounts.verify_password(context.database, context.hasher, sign_in)
    await second_factor.require_second_factor(
        context.database, verified.person_id, sign_in.second_factor, context.actor
    )
    async with context.database.begin() as db:
        await local_accounts.require_unchanged_password(db, verified)
        return await context.start_session(db, response, person_id=verified.person_id, method="password")


@router.post("/password/change", operation_id="change_password", status_code=204)
async def change_password(change: accounts.PasswordChange, context: CurrentSignIn) -> None:
    """Change your password; your other browsers are signed out."""
    context.require_local_accounts()
    await context.count_attempt(str(context.actor.person_id))
    verified = await local_accounts.verify_own_password(
        context.database, context.hasher, context.actor, change.old_password
    )
    password_hash = await context.hash_new(change.new_password, field="new_password", about=(context.actor.name,))
    async with context.database.begin() as db:
        await local_accounts.change_password(
            db, context.actor, verified=verified, new=change.new_password, password_hash=password_hash
        )


@router.post("/password/reauthenticate", operation_id="reauthenticate_by_password", status_code=204)
async def reauthenticate_by_password(entered: accounts.PasswordReauthenticate, context: CurrentSignIn) -> None:
    """Enter your password again, for operations that require a recent sign-in."""
    context.require_local_accounts()
    await context.count_attempt(str(context.actor.person_id))
    verified = await local_accounts.verify_own_password(
        context.database, context.hasher, context.actor, entered.password
    )
    await second_factor.require_second_factor(
        context.database, verified.person_id, entered.second_factor, context.actor
    )
    async with context.database.begin() as db:
        await local_accounts.require_unchanged_password(db, verified)
        await sessions.renew_session(db, context.actor, method="password")


@router.post("/link", operation_id="sign_in_by_link", dependencies=_SAME_ORIGIN)
async def sign_in_by_link(
    link: accounts.CodeSignIn, context: CurrentSignIn, response: Response, db: Transaction
) -> accounts.BrowserSignedIn:
    """Sign a browser in with a one-time link."""
    person_id = one_time_codes.require_person(await one_time_codes.use_code(db, link.code, CodePurpose.owner))
    return await context.start_session(db, response, person_id=person_id, method="link")


@router.post("/codes", operation_id="get_code")
async def get_code(link: accounts.CodeSignIn, context: CurrentSignIn) -> accounts.CodeRead:
    """Return the purpose and recipient of a one-time link without using it."""
    await context.count_attempt()
    async with context.database.begin() as db:
        return await one_time_codes.describe_code(db, link.code)


@router.post("/invitation", operation_id="accept_invitation", dependencies=_SAME_ORIGIN)
async def accept_invitation(
    accepted: accounts.InvitationAccept, context: CurrentSignIn, response: Response
) -> accounts.BrowserSignedIn:
    """Create the account that an invitation is for, and sign in."""
    context.require_local_accounts()
    await context.count_attempt()
    password_hash = await context.hash_with_code(accepted.password, code=accepted.code, about=(accepted.name,))
    async with context.database.begin() as db:
        person_id = await local_accounts.accept_invitation(
            db, context.actor, accepted=accepted, password_hash=password_hash
        )
        return await context.start_session(db, response, person_id=person_id, method="password")


@router.post("/reset", operation_id="reset_password", dependencies=_SAME_ORIGIN)
async def reset_password(
    reset: accounts.PasswordReset, context: CurrentSignIn, response: Response
) -> accounts.BrowserSignedIn:
    """Choose a new password with an admin's link; your browsers are signed out and your personal tokens revoked.

    Tokens of robots and runners stay valid.
    """
    context.require_local_accounts()
    await context.count_attempt()
    password_hash = await context.hash_with_code(reset.password, code=reset.code)
    async with context.database.begin() as db:
        owner_id = await one_time_codes.get_code_person(db, reset.code, CodePurpose.reset)
    await second_factor.require_second_factor(context.database, owner_id, reset.second_factor, context.actor)
    async with context.database.begin() as db:
        person_id = await local_accounts.reset_password(db, context.actor, reset=reset, password_hash=password_hash)
        return await context.start_session(db, response, person_id=person_id, method="password")


@router.post("/bootstrap", operation_id="bootstrap_admin", dependencies=_SAME_ORIGIN)
async def create_first_admin(
    request: accounts.AdminBootstrap, context: CurrentSignIn, response: Response
) -> accounts.BrowserSignedIn:
    """Become the first admin of a new server with the code from its log."""
    await context.count_attempt()
    password_hash = None
    if request.password is not None:
        about = (request.name, request.email)
        password_hash = await context.hash_with_code(request.password, code=request.code, about=about)
    async with context.database.begin() as db:
        person_id = await bootstrap.bootstrap_admin(db, context.actor, request=request, password_hash=password_hash)
        return await context.start_session(db, response, person_id=person_id, method="bootstrap")


@router.post("/providers/{name}", operation_id="begin_provider_sign_in", dependencies=_SAME_ORIGIN)
async def begin_provider_sign_in(
    name: str, target: accounts.ProviderBegin, context: CurrentSignIn, response: Response
) -> accounts.ProviderBegun:
    """Start to sign in with a provider: the browser goes to the returned URL."""
    return await _redirect_to_provider(context, response, name, AuthorizationRequest(target.return_to))


@router.post("/providers/{name}/link", operation_id="link_provider")
async def link_provider(
    name: str, target: accounts.ProviderBegin, context: CurrentSignIn, response: Response
) -> accounts.ProviderBegun:
    """Start to link an identity of a provider to your account."""
    request = AuthorizationRequest(target.return_to, context.actor.session_id)
    return await _redirect_to_provider(context, response, name, request)


@router.post("/providers/{name}/reauthenticate", operation_id="begin_provider_reauthentication")
async def begin_provider_reauthentication(
    name: str, target: accounts.ProviderBegin, context: CurrentSignIn, response: Response
) -> accounts.ProviderBegun:
    """Start to reauthenticate with a provider, which is asked to require the password."""
    request = AuthorizationRequest(target.return_to, context.actor.session_id, reauthenticates=True)
    return await _redirect_to_provider(context, response, name, request)


@router.post("/owner-link", operation_id="create_owner_link")
async def create_owner_link(db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> accounts.OneTimeLink:
    """Create a link with which the owner of `klein up` signs in."""
    return await bootstrap.create_owner_link(db, actor, settings=settings)


@router.post("/sign-out", operation_id="sign_out", status_code=204, dependencies=_SAME_ORIGIN)
async def sign_out(response: Response, db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> None:
    """Sign this browser out."""
    if actor.session_id is not None:
        await sessions.end_session(db, actor, session_id=actor.session_id)
    delete_session_cookie(response, settings)


@router.post("/cli/approve", operation_id="approve_cli_login")
async def approve_cli_login(
    approval: accounts.LoopbackApproval, db: Transaction, actor: CurrentActor
) -> accounts.LoopbackApproved:
    """Approve a program on the machine of this browser."""
    return await cli_logins.approve_loopback(db, actor, approval=approval)


@router.post("/cli/token", operation_id="exchange_cli_code")
async def exchange_cli_code(exchange: accounts.CliExchange, context: CurrentSignIn) -> accounts.SignedIn:
    """Exchange the code that the browser delivered to the loopback for a token."""
    await context.count_attempt()
    async with context.database.begin() as db:
        return await cli_logins.exchange_loopback(db, context.actor, exchange=exchange, settings=context.settings)


@router.post("/device", operation_id="begin_device_login")
async def begin_device_login(begin: accounts.DeviceBegin, context: CurrentSignIn) -> accounts.DeviceCode:
    """Start a login with a code that is typed on another machine."""
    await context.count_attempt()
    async with context.database.begin() as db:
        return await cli_logins.start_device_login(db, context.actor, client=begin.client, settings=context.settings)


@router.post("/device/token", operation_id="exchange_device_code")
async def exchange_device_code(
    exchange: accounts.DeviceExchange, database: CurrentDatabase, actor: CurrentActor, settings: CurrentSettings
) -> accounts.SignedIn:
    """Exchange a device code for a token, once it is approved."""
    return await cli_logins.exchange_device_code(database, actor, device_code=exchange.device_code, settings=settings)


@router.post("/device/status", operation_id="get_device_login")
async def get_device_login(login: accounts.DeviceDecision, context: CurrentSignIn) -> accounts.DeviceRead:
    """Return the program that shows a code."""
    await context.count_attempt(str(context.actor.person_id))
    async with context.database.begin() as db:
        return await cli_logins.get_device_login(db, login.user_code)


@router.post("/device/approve", operation_id="approve_device_login")
async def approve_device_login(login: accounts.DeviceDecision, context: CurrentSignIn) -> accounts.DeviceRead:
    """Approve the program that shows a code."""
    await context.count_attempt(str(context.actor.person_id))
    async with context.database.begin() as db:
        return await cli_logins.approve_device(db, context.actor, login.user_code)


@router.post("/device/deny", operation_id="deny_device_login")
async def deny_device_login(login: accounts.DeviceDecision, context: CurrentSignIn) -> accounts.DeviceRead:
    """Deny the program that shows a code."""
    await context.count_attempt(str(context.actor.person_id))
    async with context.database.begin() as db:
        return await cli_logins.deny_device(db, context.actor, login.user_code)


@me_router.get("", operation_id="get_me")
async def get_me(db: Transaction, actor: CurrentActor) -> accounts.MeRead:
    """Return who you are, and your credential."""
    return await account.get_me(db, actor)


@me_router.get("/sessions", operation_id="list_sessions")
async def list_sessions(
    query: Annotated[PageQuery, Query()], db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> Page[accounts.SessionRead]:
    """List the browsers you are signed in with, latest first."""
    return await sessions.list_sessions(db, actor, settings=settings, page=query.page)


@me_router.delete("/sessions", operation_id="end_all_sessions", status_code=204)
async def end_all_sessions(db: Transaction, actor: CurrentActor) -> None:
    """Sign all your browsers out, including this one. Tokens stay valid."""
    await sessions.end_sessions(db, actor)


@me_router.delete("/sessions/{session_id}", operation_id="end_session", status_code=204)
async def end_session(session_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Sign one of your browsers out."""
    await sessions.end_session(db, actor, session_id=session_id)


@me_router.get("/account", operation_id="get_account")
async def get_account(db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> accounts.AccountRead:
    """Return your account: name, addresses, affiliations, and whether it has a password."""
    return await account.get_account(db, actor, settings=settings)


@me_router.get("/identities", operation_id="list_identities")
async def list_identities(
    db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> list[accounts.IdentityRead]:
    """List the identities that are linked to your account."""
    return await account.list_identities(db, actor, settings=settings)


@me_router.delete("/identities/{identity_id}", operation_id="unlink_identity", status_code=204)
async def unlink_identity(
    identity_id: uuid.UUID, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> None:
    """Unlink an identity from your account, unless it is your last sign-in method. Sessions and tokens stay valid."""
    await account.unlink_identity(db, actor, identity_id=identity_id, settings=settings)


@me_router.post("/totp", operation_id="begin_totp", status_code=201)
async def begin_totp(db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> accounts.TotpEnrolment:
    """Create a secret for an authenticator app; it takes effect once one of its codes is confirmed."""
    return await second_factor.begin_totp(db, actor, settings=settings)


@me_router.post("/totp/confirm", operation_id="confirm_totp")
async def confirm_totp(confirmation: accounts.TotpConfirm, context: CurrentSignIn) -> accounts.RecoveryCodes:
    """Confirm your second factor; your other browsers are signed out. The recovery codes are shown only once."""
    await context.count_attempt(str(context.actor.person_id))
    return await second_factor.confirm_totp(context.database, context.actor, code=confirmation.code)


@me_router.post("/totp/recovery-codes", operation_id="renew_recovery_codes")
async def renew_recovery_codes(db: Transaction, actor: CurrentActor) -> accounts.RecoveryCodes:
    """Replace your recovery codes."""
    return await second_factor.renew_recovery_codes(db, actor)


@me_router.delete("/totp", operation_id="disable_totp", status_code=204)
async def disable_totp(db: Transaction, actor: CurrentActor) -> None:
    """Remove your second factor."""
    await second_factor.disable_totp(db, actor)


@people_router.delete("/{person_id}/totp", operation_id="reset_totp", status_code=204)
async def reset_totp(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Remove the second factor of a person who lost their device and recovery codes."""
    await second_factor.reset_totp(db, actor, person_id=person_id)


@people_router.post("/invitations", operation_id="invite_person", status_code=201)
async def invite_person(
    invitation: accounts.InvitationCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> accounts.OneTimeLink:
    """Create an invitation link, which you pass on to the person."""
    return await local_accounts.create_invitation(db, actor, invitation=invitation, settings=settings)


@people_router.post("/{person_id}/reset", operation_id="create_reset_link", status_code=201)
async def create_reset_link(
    person_id: uuid.UUID, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> accounts.OneTimeLink:
    """Create a password reset link, which you pass on to the person."""
    return await local_accounts.create_reset_link(db, actor, person_id=person_id, settings=settings)


async def _redirect_to_provider(
    context: SignInContext, response: Response, provider: str, request: AuthorizationRequest
) -> accounts.ProviderBegun:
    await context.count_attempt()
    url = await context.provider(provider).authorization_url(request)
    browser_secret = bind_browser(context.request, response, context.settings)
    async with context.database.begin() as db:
        await store_request(db, request, provider=provider, browser_secret=browser_secret)
    return accounts.ProviderBegun(url=url)
