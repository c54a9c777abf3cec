"""Signing in over HTTP: what pages and programs ask for. What gives a browser a session comes from our pages only."""

from fastapi import APIRouter, Depends, Response

from kleinkram.contract.accounts import (
    BrowserSignedIn,
    Claim,
    CodeRead,
    CodeSignIn,
    InvitationAccept,
    OneTimeLink,
    PasswordAgain,
    PasswordChange,
    PasswordReset,
    PasswordSignIn,
    ProviderBegin,
    ProviderBegun,
    ProviderRef,
    SignInWays,
)
from kleinkram.server.auth import claiming, codes, journeys, local
from kleinkram.server.auth.cookies import bind_browser, drop_session
from kleinkram.server.auth.door import CurrentDoor, Door
from kleinkram.server.auth.sessions import end_session, renew_session
from kleinkram.server.auth.totp import see_second_factor
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction, require_same_origin
from kleinkram.server.tables.signing_in import CodePurpose

router = APIRouter(prefix="/api/v1/auth", tags=["signing in"])
# A foreign page must not sign somebody in as somebody else either: with a cookie or not, it takes a page of ours.
_FROM_OUR_PAGE = [Depends(require_same_origin)]


@router.get("/ways", operation_id="list_sign_in_ways")
async def list_sign_in_ways(db: Transaction, settings: CurrentSettings) -> SignInWays:
    """Say how one may sign in here."""
    providers = [ProviderRef(name=each.name, title=each.title) for each in settings.oidc_providers]
    is_claimed = await claiming.has_admin(db)
    return SignInWays(password=settings.local_accounts, providers=providers, claim=not is_claimed)


@router.post("/password", operation_id="sign_in_by_password", dependencies=_FROM_OUR_PAGE)
async def sign_in_by_password(given: PasswordSignIn, door: CurrentDoor, response: Response) -> BrowserSignedIn:
    """Sign a browser in with a local account."""
    door.see_that_passwords_are_taken()
    await door.count_try(given.email)
    proven = await local.prove_password(door.database, door.passwords, given)
    await see_second_factor(door.database, proven.person_id, given.second_factor, door.asker)
    async with door.database.begin() as db:
        await local.see_that_it_still_is(db, proven)
        return await door.let_in(db, response, person_id=proven.person_id, way="password")


@router.post("/password/change", operation_id="change_password", status_code=204)
async def change_password(wanted: PasswordChange, door: CurrentDoor) -> None:
    """Choose a new password; one's other browsers are signed out."""
    door.see_that_passwords_are_taken()
    await door.count_try(str(door.asker.person_id))
    proven = await local.prove_own_password(door.database, door.passwords, door.asker, wanted.old_password)
    hashed = await door.hash_new(wanted.new_password, field="new_password", about=(door.asker.name,))
    async with door.database.begin() as db:
        await local.change_password(db, door.asker, proven=proven, new=wanted.new_password, hashed=hashed)


@router.post("/password/again", operation_id="prove_password_again", status_code=204)
async def prove_password_again(given: PasswordAgain, door: CurrentDoor) -> None:
    """Prove once more who one is, so that this browser may do what takes a fresh sign-in."""
    door.see_that_passwords_are_taken()
    await door.count_try(str(door.asker.person_id))
    proven = await local.prove_own_password(door.database, door.passwords, door.asker, given.password)
    await see_second_factor(door.database, proven.person_id, given.second_factor, door.asker)
    async with door.database.begin() as db:
        await local.see_that_it_still_is(db, proven)
        await renew_session(db, door.asker, way="password")


@router.post("/link", operation_id="sign_in_by_link", dependencies=_FROM_OUR_PAGE)
async def sign_in_by_link(given: CodeSignIn, door: CurrentDoor, response: Response, db: Transaction) -> BrowserSignedIn:
    """Sign a browser in by a link that is good once."""
    row = await codes.use_code(db, given.code, CodePurpose.owner)
    return await door.let_in(db, response, person_id=row.person_id, way="link")


@router.post("/codes", operation_id="look_at_code")
async def look_at_code(given: CodeSignIn, door: CurrentDoor) -> CodeRead:
    """Say for whom a link is; it stays good."""
    await door.count_try()
    async with door.database.begin() as db:
        return await codes.look_at_code(db, given.code)


@router.post("/invitation", operation_id="accept_invitation", dependencies=_FROM_OUR_PAGE)
async def accept_invitation(accepted: InvitationAccept, door: CurrentDoor, response: Response) -> BrowserSignedIn:
    """Get the account that one is invited to, and sign in."""
    door.see_that_passwords_are_taken()
    await door.count_try()
    hashed = await door.hash(accepted.password, code=accepted.code, about=(accepted.name,))
    async with door.database.begin() as db:
        person_id = await local.accept_invitation(db, door.asker, accepted=accepted, hashed=hashed)
        return await door.let_in(db, response, person_id=person_id, way="password")


@router.post("/reset", operation_id="reset_password", dependencies=_FROM_OUR_PAGE)
async def reset_password(reset: PasswordReset, door: CurrentDoor, response: Response) -> BrowserSignedIn:
    """Choose a new password by an admin's link; all other browsers are signed out, and all personal tokens end.

    Those of robots and runners stay.
    """
    door.see_that_passwords_are_taken()
    await door.count_try()
    hashed = await door.hash(reset.password, code=reset.code)
    async with door.database.begin() as db:
        whose = await local.whose_reset(db, reset.code)
    await see_second_factor(door.database, whose, reset.second_factor, door.asker)
    async with door.database.begin() as db:
        person_id = await local.reset_password(db, door.asker, reset=reset, hashed=hashed)
        return await door.let_in(db, response, person_id=person_id, way="password")


@router.post("/claim", operation_id="claim_server", dependencies=_FROM_OUR_PAGE)
async def claim_server(claimed: Claim, door: CurrentDoor, response: Response) -> BrowserSignedIn:
    """Become the first admin of a fresh server, by the code from its log."""
    await door.count_try()
    hashed = None
    if claimed.password is not None:
        about = (claimed.name, claimed.email)
        hashed = await door.hash(claimed.password, code=claimed.code, about=about)
    async with door.database.begin() as db:
        person_id = await claiming.claim(db, door.asker, claimed=claimed, hashed=hashed)
        return await door.let_in(db, response, person_id=person_id, way="claim")


@router.post("/providers/{name}", operation_id="begin_provider_sign_in", dependencies=_FROM_OUR_PAGE)
async def begin_provider_sign_in(
    name: str, wanted: ProviderBegin, door: CurrentDoor, response: Response
) -> ProviderBegun:
    """Begin to sign in by a provider: the browser goes where this says."""
    return await _begin(door, response, provider=name, journey=journeys.new_journey(wanted.return_to))


@router.post("/providers/{name}/link", operation_id="link_provider")
async def link_provider(name: str, wanted: ProviderBegin, door: CurrentDoor, response: Response) -> ProviderBegun:
    """Begin to add a provider to one's account, as another way to sign in."""
    journey = journeys.new_journey(wanted.return_to, session_id=door.asker.session_id)
    return await _begin(door, response, provider=name, journey=journey)


@router.post("/providers/{name}/again", operation_id="begin_provider_sign_in_again")
async def begin_provider_sign_in_again(
    name: str, wanted: ProviderBegin, door: CurrentDoor, response: Response
) -> ProviderBegun:
    """Begin to prove once more who one is, by a provider, which is asked to ask for the password anew."""
    journey = journeys.new_journey(wanted.return_to, session_id=door.asker.session_id, renews=True)
    return await _begin(door, response, provider=name, journey=journey)


@router.post("/owner-link", operation_id="create_owner_link")
async def create_owner_link(db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> OneTimeLink:
    """Make a link by which the owner of `klein up` signs a browser in."""
    return await claiming.owner_link(db, actor, settings=settings)


@router.post("/sign-out", operation_id="sign_out", status_code=204, dependencies=_FROM_OUR_PAGE)
async def sign_out(response: Response, db: Transaction, actor: CurrentActor, settings: CurrentSettings) -> None:
    """Sign this browser out."""
    if actor.session_id is not None:
        await end_session(db, actor, session_id=actor.session_id)
    drop_session(response, settings)


async def _begin(door: Door, response: Response, *, provider: str, journey: journeys.Journey) -> ProviderBegun:
    await door.count_try()
    url = await door.providers.get(provider).authorization_url(journey.challenge, again=journey.renews)
    browser = bind_browser(door.request, response, door.settings)
    async with door.database.begin() as db:
        await journeys.begin_journey(db, provider=provider, journey=journey, browser=browser)
    return ProviderBegun(url=url)
