"""Getting a token for this machine: through a browser on it, by a code typed on another, or by one brought along.

Nothing is kept here: what comes back is the caller's to save (`saved_endpoints`). The secrets of a login under way stay
in this process: what the browser carries is of no use without the verifier (PKCE).
"""

import base64
import hashlib
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from urllib.parse import urlencode

from kleinkram.client._http import Api
from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.client.errors import ServerUnreachable
from kleinkram.client.loopback import Loopback
from kleinkram.client.me import Me
from kleinkram.client.saved_endpoints import normal_url
from kleinkram.contract.errors import NotAuthenticated, RateLimited, SignInExpired, SignInPending, SlowDown
from kleinkram.contract.signing_in import CliExchange, DeviceBegin, DeviceCode, DeviceExchange, MeRead, SignedIn

# How long somebody may take over the page in the browser; the server's codes live no longer.
BROWSER_PATIENCE_S = 300.0
_LONGEST_INTERVAL_S = 60.0


@dataclass(frozen=True)
class BrowserLogin:
    """A login that waits for a browser: `url` is what to open."""

    url: str
    _server: str
    _verifier: str = field(repr=False)
    _loopback: Loopback = field(repr=False)

    def wait(self, timeout_s: float = BROWSER_PATIENCE_S) -> SignedIn:
        """Wait until the page has sent the browser back, and exchange what it brought for a token.

        Raises:
            SignInDenied: the person refused.
            SignInExpired: nothing came in time, or the server knows the code no more.
        """
        code = self._loopback.wait(timeout_s)
        with _stranger(self._server) as api:
            return api.send("POST", "/auth/cli/token", SignedIn, CliExchange(code=code, code_verifier=self._verifier))


@contextmanager
def begin_browser(url: str, client: str) -> Iterator[BrowserLogin]:
    """Listen on this machine's loopback for a browser, for as long as the context lasts.

    `client` is what the person reads on the page and what their new token is called.
    """
    server, state, verifier = normal_url(url), secrets.token_urlsafe(32), secrets.token_urlsafe(64)
    digest = hashlib.sha256(verifier.encode()).digest()
    challenge = base64.urlsafe_b64encode(digest).decode().rstrip("=")
    with Loopback(state) as loopback:
        query = {"port": loopback.port, "state": state, "code_challenge": challenge, "client": client}
        yield BrowserLogin(f"{server}/sign-in/cli?{urlencode(query)}", server, verifier, loopback)


def begin_device(url: str, client: str) -> DeviceCode:
    """Ask a server for a code that can be typed on any machine with a browser."""
    with _stranger(normal_url(url)) as api:
        return api.send("POST", "/auth/device", DeviceCode, DeviceBegin(client=client))


def wait_for_device(url: str, code: DeviceCode, wait: Callable[[float], object] = time.sleep) -> SignedIn:
    """Ask until the code was typed, no more often than the server wants; a network that is away is waited for.

    Raises:
        SignInDenied: the person refused.
        SignInExpired: nobody typed it in time.
    """
    interval_s, left_s = code.interval_s, code.expires_s
    with _stranger(normal_url(url)) as api:
        while left_s > 0:
            wait(interval_s)
            left_s -= interval_s
            try:
                return api.send("POST", "/auth/device/token", SignedIn, DeviceExchange(device_code=code.device_code))
            except SignInPending as pending:
                interval_s = max(interval_s, pending.interval_s)
            except SlowDown as slower:
                interval_s = max(interval_s, slower.interval_s)
            except RateLimited as limited:
                wait(limited.retry_after_s)
                left_s -= limited.retry_after_s
            except ServerUnreachable:
                interval_s = min(interval_s * 2, _LONGEST_INTERVAL_S)
    raise SignInExpired


def who_has(url: str, token: str) -> MeRead:
    """Return whose a token is.

    Raises:
        NotAuthenticated: the server does not know it.
    """
    with _carrier(normal_url(url), token) as api:
        return Me(api).get()


def end_token(url: str, token: str) -> bool:
    """Revoke a token at its server; False where it was good for nothing already."""
    with _carrier(normal_url(url), token) as api:
        try:
            Me(api).sign_out()
        except NotAuthenticated:
            return False
    return True


def see_server(url: str) -> None:
    """See that a Kleinkram server answers, before somebody is sent there.

    Raises:
        ServerUnreachable: nothing answers.
        AnswerNotUnderstood: something else does.
    """
    with _stranger(normal_url(url)) as api, suppress(NotAuthenticated):
        Me(api).get()


def _stranger(url: str) -> AbstractContextManager[Api]:
    return _carrier(url, None)


@contextmanager
def _carrier(url: str, token: str | None) -> Iterator[Api]:
    api = Api(Endpoint("(given)", url, token, EndpointSource.argument))
    try:
        yield api
    finally:
        api.close()
