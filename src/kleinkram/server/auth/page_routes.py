"""The pages of signing in over HTTP, and where providers send browsers back to."""

from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from pydantic import BaseModel, ConfigDict, Field

from kleinkram.contract.errors import KleinkramError, NotFound, SignInRefused
from kleinkram.server.auth import accounts, journeys, pages
from kleinkram.server.auth.cookies import bound_browser
from kleinkram.server.auth.door import CurrentDoor, Door
from kleinkram.server.http.dependencies import CurrentSettings
from kleinkram.server.http.errors import record_refusal
from kleinkram.server.settings import Settings

# Not part of the API: for people, not for programs.
router = APIRouter(prefix="/sign-in", include_in_schema=False)
_PAGES: dict[str, Callable[[Settings], HTMLResponse]] = {
    "link": pages.link_page,
    "invitation": pages.invitation_page,
    "reset": pages.reset_page,
    "claim": pages.claim_page,
    "device": pages.device_page,
    "cli": pages.cli_page,
}
_STATIC = {"sign-in.js": "text/javascript", "sign-in.css": "text/css"}
_Text = Annotated[str, Field(max_length=2000)]


class Returned(BaseModel):
    """What a provider gives a browser to bring back. Providers add to it as they like."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    state: _Text = ""
    code: _Text | None = None
    error: _Text | None = None
    iss: _Text | None = None


@router.get("")
async def sign_in(settings: CurrentSettings) -> HTMLResponse:
    """Show the ways to sign in."""
    return pages.sign_in_page(settings)


@router.get("/static/{name}")
async def static(name: str) -> Response:
    """Give the pages' script and stylesheet."""
    if name not in _STATIC:
        raise NotFound(noun="page", ref=name)
    return Response(_read(name), media_type=_STATIC[name], headers={"X-Content-Type-Options": "nosniff"})


@router.get("/callback/{provider}", operation_id="end_provider_sign_in")
async def end_provider_sign_in(
    provider: str, query: Annotated[Returned, Query()], request: Request, door: CurrentDoor
) -> Response:
    """Take a browser back that comes from a provider, signed in or with a sentence that says why not."""
    try:
        return await _welcome(door, provider, query)
    except KleinkramError as error:
        await record_refusal(request, error)
        return pages.error_page(door.settings, error)


@router.get("/{name}")
async def page(name: str, settings: CurrentSettings) -> HTMLResponse:
    """Show one of the other pages."""
    if name not in _PAGES:
        raise NotFound(noun="page", ref=name)
    return _PAGES[name](settings)


async def _welcome(door: Door, name: str, returned: Returned) -> Response:
    provider = door.providers.get(name)
    ticket = journeys.Ticket(returned.state, bound_browser(door.request, door.settings))
    async with door.database.begin() as db:  # of its own: whatever comes of it, it was good once
        journey = await journeys.end_journey(db, provider=name, ticket=ticket)
    code = _code(returned, provider.settings.title, provider.settings.issuer)
    vouched = await provider.vouch(code, journey.challenge)
    response = RedirectResponse(journey.return_to, status_code=303, headers={"Cache-Control": "no-store"})
    async with door.database.begin() as db:
        if journey.session_id is not None:
            if journey.session_id != door.asker.session_id:
                raise SignInRefused(reason="you signed out meanwhile, so nothing was changed. Sign in and begin again.")
            if journey.renews:
                await accounts.renew_sign_in(db, door.asker, vouched=vouched, provider=provider.settings)
                return response
            await accounts.link_identity(db, door.asker, vouched=vouched, provider=provider.settings)
            return response
        person_id = await accounts.open_account(db, door.asker, vouched=vouched, provider=provider.settings)
        await door.let_in(db, response, person_id=person_id, way=vouched.issuer)
    return response


def _code(returned: Returned, title: str, issuer: str) -> str:
    if returned.error == "access_denied":
        raise SignInRefused(reason=f"you, or {title}, did not agree to it. Begin again if you want to.")
    if returned.error is not None or returned.code is None:
        raise SignInRefused(reason=f"{title} sent you back with an error ({(returned.error or 'no code')[:60]}).")
    if returned.iss is not None and returned.iss != issuer:  # RFC 9207
        raise SignInRefused(reason=f"the answer is not from {title}. Begin again.")
    return returned.code


@cache
def _read(name: str) -> bytes:
    return (resources.files("kleinkram.server.auth") / "static" / name).read_bytes()
