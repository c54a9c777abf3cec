"""The pages of signing in: plain HTML, one script and one stylesheet of ours, nothing inline or from elsewhere.

Pages change nothing by being looked at; what they do goes through the JSON API. What others sent is escaped.
"""

from html import escape

from fastapi.responses import HTMLResponse

from kleinkram.contract.errors import KleinkramError
from kleinkram.server.http.headers import PAGE_POLICY
from kleinkram.server.http.pages import LOOK, brand
from kleinkram.server.settings import Settings

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": PAGE_POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_EMAIL = '<label>E-mail address<input name="email" type="email" autocomplete="username" required></label>'
_CHOSEN = (
    '<label>New password, at least 10 characters<input name="password" type="password" autocomplete="new-password" '
    'minlength="10" maxlength="256" required></label>'
)
_SECOND_FACTOR = (
    '<label id="second-factor" hidden>Code from your authenticator app, or a recovery code<input name="second_factor" '
    'autocomplete="one-time-code" spellcheck="false" maxlength="40"></label>'
)
_NAME = '<label>Your name<input name="name" autocomplete="name" maxlength="128" required></label>'


def sign_in_page(settings: Settings) -> HTMLResponse:
    """Return the page that offers the ways to sign in."""
    ways = [_provider_button(each.name, f"Sign in with {each.title}") for each in settings.oidc_providers]
    if settings.local_accounts:
        form = f'{_EMAIL}<label>Password<input name="password" type="password" autocomplete="current-password"'
        ways.append(_form("password", f"{form} required></label>{_SECOND_FACTOR}", "Sign in"))
        ways.append('<p class="small">Forgotten it? An admin of this server can give you a link to a new one.</p>')
    claim = (
        '<p class="small" id="claim" hidden>Nobody is admin yet: <a href="/sign-in/claim">claim this server</a>.</p>'
    )
    return _page(settings, "Sign in", "sign-in", "".join(ways) + claim)


def link_page(settings: Settings) -> HTMLResponse:
    """Return the page that a one-time link of the owner opens."""
    return _page(settings, "Signing in", "link", '<p id="doing">One moment.</p>')


def invitation_page(settings: Settings) -> HTMLResponse:
    """Return the page that an invitation opens."""
    fields = '<p id="for"></p>' + _NAME + _CHOSEN
    return _page(settings, "Your account", "invitation", _form("invitation", fields, "Make my account"))


def reset_page(settings: Settings) -> HTMLResponse:
    """Return the page on which a new password is chosen."""
    form = _form("reset", f'<p id="for"></p>{_CHOSEN}{_SECOND_FACTOR}', "Keep this password")
    return _page(settings, "A new password", "reset", form)


def claim_page(settings: Settings) -> HTMLResponse:
    """Return the page on which the first admin proves that they can read the server's log."""
    code = '<label>Claim code, from the server’s log<input name="code" autocomplete="off" required></label>'
    form = _form("claim", code + _NAME + _EMAIL + _CHOSEN, "Become admin")
    return _page(settings, "Claim this server", "claim", form)


def device_page(settings: Settings) -> HTMLResponse:
    """Return the page on which the code is typed that a program shows."""
    code = (
        '<label>The code that it shows<input name="user_code" autocomplete="off" spellcheck="false" required></label>'
    )
    form = _form("device", code, "Go on")
    return _page(settings, "Sign a program in", "device", form + _decision())


def cli_page(settings: Settings) -> HTMLResponse:
    """Return the page on which somebody agrees that a program on their machine signs in."""
    return _page(settings, "Sign a program in", "cli", _decision())


def error_page(settings: Settings, error: KleinkramError) -> HTMLResponse:
    """Return the page that says what went wrong, in the error's own sentence."""
    body = f'<p role="alert">{escape(error.sentence())}</p><p><a href="/sign-in">Sign in</a></p>'
    return _page(settings, "Not signed in", "error", body, status=error.status)


def _page(settings: Settings, title: str, name: str, body: str, *, status: int = 200) -> HTMLResponse:
    html = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)} · {escape(settings.lab_name)}</title>{LOOK}"
        '<link rel="stylesheet" href="/sign-in/static/sign-in.css">'
        '<script src="/sign-in/static/sign-in.js" defer></script></head>'
        f'<body data-page="{name}" data-origin="{escape(settings.public_origin)}">{brand(settings)}'
        f"<main><h1>{escape(title)}</h1>"
        f'<p id="said" role="status" hidden></p>{body}<noscript><p>These pages need JavaScript.</p></noscript>'
        "</main></body></html>"
    )
    return HTMLResponse(html, status_code=status, headers=HEADERS)


# Buttons are disabled until the script is there: pressed before, one would do nothing, or send its form by itself.
def _form(name: str, fields: str, button: str) -> str:
    pressed = f'<button class="primary" disabled>{escape(button)}</button>'
    return f'<form method="post" data-form="{name}">{fields}{pressed}</form>'


def _provider_button(name: str, text: str) -> str:
    return f'<button type="button" disabled data-act="begin" data-provider="{escape(name)}">{escape(text)}</button>'


def _decision() -> str:
    return (
        '<section id="decision" hidden><p id="asks"></p><p class="small">It will be able to do all that you may do. '
        "Agree only if you started it yourself just now.</p>"
        '<button type="button" class="primary" disabled data-act="approve">Agree</button>'
        '<button type="button" disabled data-act="deny">Refuse</button></section>'
    )
