"""The sign-in pages: plain HTML with one script and stylesheet of this server, and the callback of providers.

Loading a page changes nothing; actions use the JSON API. All text from others is escaped.
"""

from functools import cache
from html import escape
from importlib import resources
from typing import Annotated
from urllib.parse import parse_qs

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse
from pydantic import BaseModel, ConfigDict, Field

from kleinkram.contract.errors import KleinkramError, NotFound, SignInRefused
from kleinkram.server.auth import provider_accounts
from kleinkram.server.auth.dependencies import CurrentSignIn, SignInContext, bound_browser
from kleinkram.server.auth.provider_accounts import take_request
from kleinkram.server.auth.provider_checks import LogoutTokenInvalid, end_provider_sessions
from kleinkram.server.auth.sessions import SignInMethod
from kleinkram.server.http.dependencies import CurrentSettings
from kleinkram.server.http.errors import audit_refusal
from kleinkram.server.http.headers import PAGE_POLICY
from kleinkram.server.http.web_app import PAGE_HEAD, brand
from kleinkram.server.settings import Settings

# Pages for people, not part of the API.
router = APIRouter(prefix="/sign-in", include_in_schema=False)
_STATIC = {"sign-in.js": "text/javascript", "sign-in.css": "text/css"}
_Text = Annotated[str, Field(max_length=2000)]
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": PAGE_POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_EMAIL_FIELD = '<label>E-mail address<input name="email" type="email" autocomplete="username" required></label>'
_CHOOSE_FIELD = (
    '<label>New password, at least 10 characters<input name="password" type="password" autocomplete="new-password" '
    'minlength="10" maxlength="256" required></label>'
)
_SECOND_FACTOR_FIELD = (
    '<label id="second-factor" hidden>Code from your authenticator app, or a recovery code<input name="second_factor" '
    'autocomplete="one-time-code" spellcheck="false" maxlength="40"></label>'
)
_NAME_FIELD = '<label>Your name<input name="name" autocomplete="name" maxlength="128" required></label>'


def sign_in_page(settings: Settings) -> HTMLResponse:
    """Return the page with the sign-in methods."""
    methods = [
        f'<button type="button" disabled data-act="start" data-provider="{escape(provider.name)}">'
        f"{escape(f'Sign in with {provider.title}')}</button>"
        for provider in settings.oidc_providers
    ]
    if settings.local_accounts:
        form = f'{_EMAIL_FIELD}<label>Password<input name="password" type="password" autocomplete="current-password"'
        methods.append(_form("password", f"{form} required></label>{_SECOND_FACTOR_FIELD}", "Sign in"))
        methods.append('<p class="small">Forgotten it? Ask an admin of this server for a reset link.</p>')
    methods.append(
        '<p class="small" id="bootstrap" hidden>This server has no admin yet: '
        '<a href="/sign-in/bootstrap">become its first admin</a>.</p>'
    )
    return _page(settings, "Sign in", "sign-in", "".join(methods))


def error_page(settings: Settings, error: KleinkramError) -> HTMLResponse:
    """Return the page that shows an error."""
    body = f'<p role="alert">{escape(error.sentence())}</p><p><a href="/sign-in">Sign in</a></p>'
    return _page(settings, "Not signed in", "error", body, status=error.status)


def _page(settings: Settings, title: str, name: str, body: str, *, status: int = 200) -> HTMLResponse:
    html = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)} · {escape(settings.lab_name)}</title>{PAGE_HEAD}"
        '<link rel="stylesheet" href="/sign-in/static/sign-in.css">'
        '<script src="/sign-in/static/sign-in.js" defer></script></head>'
        f'<body data-page="{name}" data-origin="{escape(settings.public_origin)}">{brand(settings)}'
        f"<main><h1>{escape(title)}</h1>"
        f'<p id="message" role="status" hidden></p>{body}<noscript><p>These pages need JavaScript.</p></noscript>'
        "</main></body></html>"
    )
    return HTMLResponse(html, status_code=status, headers=_HEADERS)


# Buttons are disabled until the script has loaded: before, they would do nothing or submit the form themselves.
def _form(name: str, fields: str, button: str) -> str:
    submit = f'<button class="primary" disabled>{escape(button)}</button>'
    return f'<form method="post" data-form="{name}">{fields}{submit}</form>'


_DECISION = (
    '<section id="decision" hidden><p id="asks"></p><p class="small">It will be able to do everything you can do. '
    "Approve only a program that you have just started yourself.</p>"
    '<button type="button" class="primary" disabled data-act="approve">Approve</button>'
    '<button type="button" disabled data-act="deny">Deny</button></section>'
)


def _code_field(label: str, name: str) -> str:
    return f'<label>{label}<input name="{name}" autocomplete="off" spellcheck="false" required></label>'


# The other pages, by name: their title and body.
_PAGES = {
    "link": ("Signing in", '<p id="doing">One moment.</p>'),
    "invitation": (
        "Your account",
        _form("invitation", f'<p id="for"></p>{_NAME_FIELD}{_CHOOSE_FIELD}', "Create my account"),
    ),
    "reset": (
        "A new password",
        _form("reset", f'<p id="for"></p>{_CHOOSE_FIELD}{_SECOND_FACTOR_FIELD}', "Set this password"),
    ),
    # The code shows that the first admin can read the server's log.
    "bootstrap": (
        "First admin",
        _form(
            "bootstrap",
            _code_field("Bootstrap code, from the server’s log", "code") + _NAME_FIELD + _EMAIL_FIELD + _CHOOSE_FIELD,
            "Become admin",
        ),
    ),
    "device": (
        "Sign a program in",
        _form("device", _code_field("The code that the program shows", "user_code"), "Continue") + _DECISION,
    ),
    "cli": ("Sign a program in", _DECISION),
}


class CallbackQuery(BaseModel):
    """Query parameters with which a provider sends a browser back; providers may add others."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    state: _Text = ""
    code: _Text | None = None
    error: _Text | None = None
    iss: _Text | None = None


@router.get("")
async def sign_in(settings: CurrentSettings) -> HTMLResponse:
    """Show the sign-in page."""
    return sign_in_page(settings)


@router.get("/static/{name}")
async def static(name: str) -> Response:
    """Return the script or stylesheet of the pages."""
    if name not in _STATIC:
        raise NotFound(resource_type="page", ref=name)
    return Response(_read(name), media_type=_STATIC[name], headers={"X-Content-Type-Options": "nosniff"})


@router.get("/callback/{provider}", operation_id="end_provider_sign_in")
async def end_provider_sign_in(
    provider: str, query: Annotated[CallbackQuery, Query()], request: Request, context: CurrentSignIn
) -> Response:
    """Finish a sign-in with a provider, or show an error page."""
    try:
        return await _finish_sign_in(context, provider, query)
    except KleinkramError as error:
        await audit_refusal(request, error)
        return error_page(context.settings, error)


async def _finish_sign_in(context: SignInContext, name: str, query: CallbackQuery) -> Response:
    provider = context.provider(name)
    browser_secret = bound_browser(context.request, context.settings)
    async with context.database.begin() as db:  # of its own, so that the request is used up even if the rest fails
        request = await take_request(db, provider=name, state=query.state, browser_secret=browser_secret)
    actor, settings = context.actor, provider.settings
    if query.error == "access_denied":
        raise SignInRefused(reason=f"you or {settings.title} denied access. Start again if you want to.")
    if query.error is not None or query.code is None:
        error = (query.error or "no code")[:60]
        raise SignInRefused(reason=f"{settings.title} sent you back with an error ({error}).")
    if query.iss is not None and query.iss != settings.issuer:  # RFC 9207
        raise SignInRefused(reason=f"the response is not from {settings.title}. Start again.")
    verified = await provider.verify_callback(query.code, request)
    response = RedirectResponse(request.return_to, status_code=303, headers={"Cache-Control": "no-store"})
    async with context.database.begin() as db:
        if request.session_id is None:
            person_id = await provider_accounts.open_account(db, actor, verified=verified, provider=settings)
            identity_id = await provider_accounts.confirm_identity(db, verified)
            method = SignInMethod(verified.issuer, identity_id, verified.session_id)
            await context.start_session(db, response, person_id=person_id, method=method)
        elif request.session_id != actor.session_id:
            raise SignInRefused(reason="you have signed out, so nothing changed. Sign in and start again.")
        elif request.reauthenticates:
            await provider_accounts.reauthenticate(db, actor, verified=verified, provider=settings)
        else:
            await provider_accounts.link_identity(db, actor, verified=verified, provider=settings)
    return response


@router.post("/backchannel-logout/{provider}", operation_id="end_provider_sessions")
async def end_sessions_of_provider(provider: str, request: Request, context: CurrentSignIn) -> Response:
    """End the sessions that a provider's logout token names: OpenID Connect Back-Channel Logout 1.0, section 2.5."""
    await context.count_provider_logout()
    headers = {"Cache-Control": "no-store"}
    try:
        fields = parse_qs((await request.body()).decode("ascii", errors="replace"))
        logout = await context.provider(provider).verify_logout_token(fields.get("logout_token", [""])[0])
        async with context.database.begin() as db:
            await end_provider_sessions(db, context.actor, logout=logout)
    except LogoutTokenInvalid as error:
        await audit_refusal(request, SignInRefused(reason=str(error)))
        problem = {"error": "invalid_request", "error_description": str(error)}
        return JSONResponse(problem, status_code=400, headers=headers)
    return Response(status_code=200, headers=headers)


@router.get("/{name}")
async def page(name: str, settings: CurrentSettings) -> HTMLResponse:
    """Show one of the other pages."""
    if name not in _PAGES:
        raise NotFound(resource_type="page", ref=name)
    title, body = _PAGES[name]
    return _page(settings, title, name, body)


@cache
def _read(name: str) -> bytes:
    return (resources.files("kleinkram.server.auth") / "static" / name).read_bytes()
