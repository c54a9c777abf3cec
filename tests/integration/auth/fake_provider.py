"""A small OpenID provider for quick tests: it signs in any person and fails on demand.

It keeps to the protocol as far as a relying party can tell: codes are good once and bound to their PKCE challenge. The
real thing is `tests/system/test_oidc.py`.
"""

import base64
import hashlib
import itertools
import json
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Any
from urllib.parse import parse_qs, urlencode, urlsplit

from joserfc import jwt
from joserfc.jwk import KeySet, RSAKey

from tests.http_server import QuietHandler, serving

# Generating one takes a quarter of a second. Providers use these in turn, each with a new key id.
_KEYS = 4
_turns = itertools.count()
CLIENT_ID = "kleinkram"
CLIENT_SECRET = "a secret with + and % in it"


@dataclass
class FakeProvider:
    """The provider, and how it behaves from now on. `change` sees an ID token's claims before they are signed."""

    url: str = ""
    person: dict[str, Any] = field(default_factory=dict)
    keys: list[RSAKey] = field(default_factory=list)
    change: Callable[[dict[str, Any]], dict[str, Any]] = field(default=lambda claims: claims)
    algorithm: str = "RS256"
    issuer: str | None = None
    userinfo_claims: bool = False
    error: str | None = None
    is_dead: set[str] = field(default_factory=set)
    seen: list[str] = field(default_factory=list)
    # The claim `sid` of sign-ins from now on.
    session_id: str | None = None
    # Whose refresh tokens are valid, and the OAuth error that all others get.
    refresh_tokens: dict[str, str] = field(default_factory=dict)
    refresh_error: str = "invalid_grant"
    # The errors of the next refusals, before `refresh_error`.
    refresh_errors: list[str] = field(default_factory=list)
    refreshed_id_token: str | None = None
    grants_refresh_tokens: bool = True
    _codes: dict[str, dict[str, str]] = field(default_factory=dict)

    def rotate(self, *, keep_old: bool = False) -> None:
        """Sign with a new key from now on."""
        raw = _key(next(_turns) % _KEYS).raw_value
        made = RSAKey(raw, raw, {"kid": secrets.token_hex(4)})
        self.keys = [made, *(self.keys if keep_old else [])]

    def sign_in_as(self, subject: str, **claims: Any) -> None:
        """Sign in as this person from now on."""
        self.person = {"sub": subject, **claims}

    def authorize(self, url: str) -> str:
        """Do what a browser and a person do at the provider; return where the browser is sent back to."""
        requested = {name: values[0] for name, values in parse_qs(urlsplit(url).query).items()}
        assert (requested["client_id"], requested["response_type"], requested["code_challenge_method"]) == (
            *(CLIENT_ID, "code", "S256"),
        )
        assert "openid" in requested["scope"].split()
        if self.error is not None:
            return f"{requested['redirect_uri']}?{urlencode({'error': self.error, 'state': requested['state']})}"
        code = secrets.token_urlsafe(16)
        self._codes[code] = requested
        return f"{requested['redirect_uri']}?{urlencode({'code': code, 'state': requested['state'], 'iss': self.url})}"

    def answer(self, path: str, body: dict[str, str], headers: dict[str, str]) -> tuple[int, Any]:
        """Answer a request of the relying party."""
        self.seen.append(path)
        if path in self.is_dead:
            return 503, {"error": "dead"}
        if path == "/.well-known/openid-configuration":
            return 200, {
                "issuer": self.issuer or self.url,
                **{f"{name}_endpoint": f"{self.url}/{name}" for name in ("authorization", "token", "userinfo")},
                "jwks_uri": f"{self.url}/jwks",
            }
        if path == "/jwks":
            return 200, KeySet(list(self.keys)).as_dict(private=False)
        if path == "/userinfo":
            return 200, self.person
        return self._token(body, headers)

    def remove(self, subject: str) -> None:
        """Remove an account: its refresh tokens are refused from now on."""
        self.refresh_tokens = {key: whose for key, whose in self.refresh_tokens.items() if whose != subject}

    def sign(self, claims: dict[str, Any], *, typ: str | None = None, algorithm: str | None = None) -> str:
        """Sign claims as this provider."""
        key, algorithm = self.keys[0], algorithm or self.algorithm
        header = {"alg": algorithm, "kid": key.kid, **({} if typ is None else {"typ": typ})}
        return jwt.encode(header, claims, key, algorithms=[algorithm])

    def logout_token(self, **claims: Any) -> str:
        """Return a logout token; claims that are None are left out."""
        now = int(time.time())
        event: dict[str, Any] = {"http://schemas.openid.net/event/backchannel-logout": {}}
        sent = {"iss": self.url, "aud": CLIENT_ID, "iat": now, "exp": now + 120, "jti": secrets.token_hex(8)}
        sent |= {"events": event, **claims}
        return self.sign({name: value for name, value in sent.items() if value is not None}, typ="logout+jwt")

    def _refresh(self, refresh_token: str) -> tuple[int, Any]:
        subject = self.refresh_tokens.pop(refresh_token, None)
        if subject is None:
            return 400, {"error": self.refresh_errors.pop(0) if self.refresh_errors else self.refresh_error}
        answer = {"access_token": "at", "token_type": "Bearer", "refresh_token": self._new_refresh_token(subject)}
        return 200, answer | ({} if self.refreshed_id_token is None else {"id_token": self.refreshed_id_token})

    def _new_refresh_token(self, subject: str) -> str:
        made = secrets.token_urlsafe(16)
        self.refresh_tokens[made] = subject
        return made

    def _token(self, body: dict[str, str], headers: dict[str, str]) -> tuple[int, Any]:
        sent = base64.b64decode(headers["authorization"].removeprefix("Basic ")).decode()
        assert parse_qs(f"x={sent.partition(':')[2]}")["x"] == [CLIENT_SECRET]
        if body["grant_type"] == "refresh_token":
            return self._refresh(body["refresh_token"])
        requested = self._codes.pop(body.get("code", ""), None)
        digest = hashlib.sha256(body["code_verifier"].encode()).digest()
        challenge = base64.urlsafe_b64encode(digest).decode().rstrip("=")
        if (
            requested is None
            or challenge != requested["code_challenge"]
            or body["redirect_uri"] != requested["redirect_uri"]
        ):
            return 400, {"error": "invalid_grant"}
        now = int(time.time())
        person = {"sub": self.person["sub"]} if self.userinfo_claims else self.person
        claims = {"iss": self.url, "aud": CLIENT_ID, "exp": now + 60, "iat": now, "nonce": requested["nonce"], **person}
        claims |= {} if self.session_id is None else {"sid": self.session_id}
        answer = {"access_token": "at", "token_type": "Bearer", "id_token": self.sign(self.change(claims))}
        if self.grants_refresh_tokens and "offline_access" in requested["scope"].split():
            answer["refresh_token"] = self._new_refresh_token(self.person["sub"])
        return 200, answer

    def reset(self) -> None:
        """Behave well again."""
        url = self.url
        self.__dict__.clear()
        self.__init__(url)  # type: ignore[misc]  # all of it anew, what tests put in the place of methods too
        self.rotate()


@cache
def _key(_number: int) -> RSAKey:
    key: RSAKey = RSAKey.generate_key(2048)
    return key


@contextmanager
def running_provider() -> Iterator[FakeProvider]:
    """Run a provider on this machine."""
    provider = FakeProvider()
    provider.rotate()

    class Answering(QuietHandler):
        def do_GET(self) -> None:
            self._answer({})

        def do_POST(self) -> None:
            fields = parse_qs(self.body().decode(), keep_blank_values=True)
            self._answer({name: values[0] for name, values in fields.items()})

        def _answer(self, body: dict[str, str]) -> None:
            headers = {name.lower(): value for name, value in self.headers.items()}
            status, message = provider.answer(urlsplit(self.path).path, body, headers)
            data = message if isinstance(message, bytes) else json.dumps(message).encode()
            self.send(status, data, {"Content-Type": "application/json"})

    with serving(Answering) as port:
        provider.url = f"http://127.0.0.1:{port}"
        yield provider
