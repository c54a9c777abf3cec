"""What every answer tells a browser: to run, embed, guess and keep nothing that the answer does not allow itself."""

from collections.abc import Iterable, Sequence

Header = tuple[bytes, bytes]

# Nothing of the API's is a page. Pages bring a policy of their own.
API_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
# What a page of ours may do: run and fetch what is ours, nothing inline and nothing from elsewhere.
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; font-src 'self'; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_ALWAYS: Sequence[Header] = (
    (b"content-security-policy", API_POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), geolocation=(), microphone=(), payment=()"),
    # Whatever the API says is somebody's, and some of it is secret: signed addresses, tokens.
    (b"cache-control", b"no-store"),
)
_YEAR_S = 365 * 86_400
_TLS_ONLY: Header = (b"strict-transport-security", f"max-age={_YEAR_S}".encode())


def guarded(headers: Iterable[Header], *, is_https: bool) -> list[Header]:
    """Return an answer's headers with those that every answer has, where it does not say otherwise itself."""
    own = list(headers)
    said = {name.lower() for name, _ in own}
    always = [*_ALWAYS, _TLS_ONLY] if is_https else _ALWAYS
    return [*own, *(header for header in always if header[0] not in said)]
