"""OpenID Connect providers: authorization code flow with PKCE, discovery, and verified ID tokens.

Authlib and joserfc do the cryptography. Discovery documents and keys are cached; keys are fetched again when a token is
signed by an unknown one. Nothing of a token is ever logged.
"""

import asyncio
import datetime
import json
import math
import time
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, TypeVar
from urllib.parse import quote_plus

import aiohttp
from authlib.oauth2.auth import ClientAuth
from authlib.oauth2.rfc6749.parameters import prepare_grant_uri, prepare_token_request
from authlib.oauth2.rfc7636 import create_s256_code_challenge
from authlib.oidc.core.claims import CodeIDToken
from joserfc import jwt
from joserfc.errors import BadSignatureError, InvalidKeyIdError, JoseError
from joserfc.jwk import KeySet
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, ValidationError

from kleinkram.contract.errors import ProviderUnavailable, SignInRefused
from kleinkram.contract.names import check_text
from kleinkram.server.auth.provider_accounts import AuthorizationRequest, VerifiedIdentity
from kleinkram.server.auth.provider_checks import LogoutRequest, LogoutTokenInvalid, RefreshedAccount
from kleinkram.server.settings import OidcProvider

T = TypeVar("T", bound=BaseModel)

# Signatures that only the provider can make: no shared secrets, and never "none".
_ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "Ed25519")
_CACHE_S = 3600.0
_CLOCK_LEEWAY_S = 60
_LOGOUT_EVENT = "http://schemas.openid.net/event/backchannel-logout"
# The age up to which a logout token is accepted; so long it is remembered, too.
_LOGOUT_TOKEN_AGE_S = 600
# Anybody can send logout tokens: those of unknown keys must not make the server fetch keys all the time.
_LOGOUT_REFETCH_S = 60.0
# OAuth errors of the client or the provider, not of an account: RFC 6749, sections 4.1.2.1 and 5.2.
_CLIENT_ERRORS = {"invalid_client", "unauthorized_client", "server_error", "temporarily_unavailable", "slow_down"}
_DISCOVERY_PATH = "/.well-known/openid-configuration"
_FORM = "application/x-www-form-urlencoded"


class DiscoveryDocument(BaseModel):
    """A provider's endpoints. Source: OpenID Connect Discovery 1.0, section 3."""

    model_config = ConfigDict(frozen=True)

    issuer: str
    authorization_endpoint: str
    token_endpoint: str
    jwks_uri: str
    userinfo_endpoint: str | None = None

    @property
    def urls(self) -> list[str]:
        """All endpoints."""
        endpoints = self.authorization_endpoint, self.token_endpoint, self.jwks_uri, self.userinfo_endpoint
        return [url for url in endpoints if url is not None]


class _Claims(BaseModel):
    """The claims that are used. Source: OpenID Connect Core 1.0, sections 2 and 5.1."""

    sub: Annotated[str, Field(min_length=1, max_length=255), AfterValidator(check_text)]
    email: Annotated[str, AfterValidator(check_text)] | None = None
    # Some providers send text.
    email_verified: bool | str | None = None
    name: str | None = None
    preferred_username: str | None = None
    auth_time: int | None = None
    sid: Annotated[str, Field(max_length=255), AfterValidator(check_text)] | None = None


class _LogoutClaims(BaseModel):
    """The claims of a logout token. Source: OpenID Connect Back-Channel Logout 1.0, section 2.4."""

    iss: str
    aud: str | list[str]
    iat: int
    exp: int | None = None
    jti: Annotated[str, Field(min_length=1, max_length=255), AfterValidator(check_text)]
    sub: Annotated[str, Field(max_length=255), AfterValidator(check_text)] | None = None
    sid: Annotated[str, Field(max_length=255), AfterValidator(check_text)] | None = None
    events: dict[str, dict[str, JsonValue]]


class _Response(NamedTuple):
    status: int
    body: JsonValue


class OpenIdProvider:
    """Client of one provider."""

    def __init__(
        self, settings: OidcProvider, http: aiohttp.ClientSession, *, redirect_url: str, secret: str | None
    ) -> None:
        self.settings = settings
        self._http = http
        self._secret = secret
        self._redirect_url = redirect_url
        self._discovery: tuple[float, DiscoveryDocument] | None = None
        self._keys: tuple[float, KeySet] | None = None
        self._keys_requested_at = -math.inf

    async def authorization_url(self, request: AuthorizationRequest) -> str:
        """Return the URL to which the browser goes, with state, nonce and the PKCE challenge.

        To reauthenticate, the provider is asked for the password even if the person is signed in there.

        Raises ProviderUnavailable.

        Source of `prompt` and `max_age`: OpenID Connect Core 1.0, section 3.1.2.1.
        """
        discovery = await self._discover()
        options = {"prompt": "login", "max_age": "0"} if request.reauthenticates else {}
        url: str = prepare_grant_uri(
            discovery.authorization_endpoint,
            client_id=self.settings.client_id,
            response_type="code",
            redirect_uri=self._redirect_url,
            scope=list(self.settings.scopes),
            state=request.state,
            nonce=request.nonce,
            code_challenge=create_s256_code_challenge(request.code_verifier),
            code_challenge_method="S256",
            **options,
        )
        return url

    async def verify_callback(self, code: str, request: AuthorizationRequest) -> VerifiedIdentity:
        """Exchange the code of a callback for an ID token and return the identity in it.

        Raises ProviderUnavailable or SignInRefused.
        """
        discovery = await self._discover()
        tokens = await self._exchange_code(discovery, code, request)
        id_token, access_token = tokens.get("id_token"), tokens.get("access_token")
        if not isinstance(id_token, str):
            raise self._refused("it sent no ID token")
        claims = await self._verify_id_token(id_token, request.nonce, access_token)
        if claims.email is None and isinstance(access_token, str):
            claims = await self._add_userinfo(discovery, claims, access_token)
        return VerifiedIdentity(
            issuer=self.settings.issuer,
            subject=claims.sub,
            email=claims.email,
            email_verified=claims.email_verified in {True, "true"},
            name=claims.name or claims.preferred_username,
            auth_time=claims.auth_time,
            session_id=claims.sid,
            refresh_token=self._refresh_token_of(tokens),
        )

    async def refresh(self, refresh_token: str, *, subject: str) -> RefreshedAccount | None:
        """Ask whether an account still exists; returns None if the provider refuses it.

        Raises ProviderUnavailable if the provider fails, or SignInRefused if its answer is not about this account.

        Source: OpenID Connect Core 1.0, section 12.
        """
        discovery = await self._discover()
        body = prepare_token_request("refresh_token", refresh_token=refresh_token)
        url, headers, body = self._add_client_auth(discovery.token_endpoint, body)
        response = await self._send("POST", url, headers=headers, data=body)
        tokens = response.body if isinstance(response.body, dict) else {}
        error = str(tokens.get("error", ""))[:60]
        if response.status in {400, 401} and error == "invalid_grant":
            return None
        if response.status in {400, 401, 403} and error and error not in _CLIENT_ERRORS:
            raise self._refused(f"it answered a refresh token with {error}")
        if response.status != 200 or not tokens:
            raise self._unavailable(
                f"it answered a refresh token with status {response.status} ({error or 'no reason'})"
            )
        if isinstance(id_token := tokens.get("id_token"), str):
            claims = (await self._verify_signature(id_token)).claims
            audience = claims.get("aud")
            if (claims.get("iss"), claims.get("sub")) != (self.settings.issuer, subject):
                raise self._refused("it answered a refresh token with another person's ID token")
            if self.settings.client_id not in (audience if isinstance(audience, list) else [audience]):
                raise self._refused("it answered a refresh token with an ID token for another client")
        return RefreshedAccount(self._refresh_token_of(tokens) or refresh_token)

    async def verify_logout_token(self, logout_token: str) -> LogoutRequest:
        """Return whose sessions a logout token ends. Raises LogoutTokenInvalid or ProviderUnavailable.

        Source: OpenID Connect Back-Channel Logout 1.0, section 2.6.
        """
        try:
            token = await self._verify_signature(logout_token, refetch_s=_LOGOUT_REFETCH_S)
            claims = _LogoutClaims.model_validate(token.claims)
        except SignInRefused as error:
            raise LogoutTokenInvalid("the logout token is malformed, or its signature is not valid") from error
        except ValidationError as error:
            raise LogoutTokenInvalid("the logout token lacks a claim, or one has another form") from error
        if problem := self._logout_problem(token, claims):
            raise LogoutTokenInvalid(f"the logout token {problem}")
        return LogoutRequest(
            issuer=claims.iss,
            provider=self.settings.title,
            subject=claims.sub,
            session_id=claims.sid,
            jti=claims.jti,
            expires_at=datetime.datetime.fromtimestamp(
                claims.iat + _LOGOUT_TOKEN_AGE_S + 2 * _CLOCK_LEEWAY_S, datetime.timezone.utc
            ),
        )

    def _logout_problem(self, token: jwt.Token, claims: _LogoutClaims) -> str | None:
        now, audience = time.time(), [claims.aud] if isinstance(claims.aud, str) else claims.aud
        if str(token.header.get("typ") or "logout+jwt").lower() not in {"logout+jwt", "jwt"}:
            return "is a token of another type"
        if claims.iss != self.settings.issuer or self.settings.client_id not in audience:
            return "is of another issuer, or for another client"
        if not now - _LOGOUT_TOKEN_AGE_S - _CLOCK_LEEWAY_S <= claims.iat <= now + _CLOCK_LEEWAY_S:
            return "is too old, or from the future"
        if claims.exp is not None and claims.exp < now - _CLOCK_LEEWAY_S:
            return "has expired"
        if _LOGOUT_EVENT not in claims.events or "nonce" in token.claims:
            return "is not about a logout"
        return None if claims.sub or claims.sid else "names neither a person nor a session"

    def _refresh_token_of(self, tokens: Mapping[str, JsonValue]) -> str | None:
        """Return the refresh token of a response, if the settings ask for ones that outlive the provider's session."""
        refresh_token = tokens.get("refresh_token")
        return refresh_token if self.settings.is_refreshable and isinstance(refresh_token, str) else None

    async def _discover(self) -> DiscoveryDocument:
        if self._discovery is not None and self._discovery[0] > time.monotonic():
            return self._discovery[1]
        body = await self._get(self.settings.issuer.rstrip("/") + _DISCOVERY_PATH)
        discovery = self._parse(body, DiscoveryDocument)
        if discovery.issuer != self.settings.issuer:
            raise self._unavailable(f"its issuer is {discovery.issuer[:200]!r}, which differs from the settings")
        if self.settings.issuer.startswith("https:") and not all(url.startswith("https:") for url in discovery.urls):
            raise self._unavailable("it has endpoints without TLS")
        self._discovery = (time.monotonic() + _CACHE_S, discovery)
        return discovery

    async def _exchange_code(
        self, discovery: DiscoveryDocument, code: str, request: AuthorizationRequest
    ) -> dict[str, JsonValue]:
        body = prepare_token_request(
            "authorization_code", code=code, redirect_uri=self._redirect_url, code_verifier=request.code_verifier
        )
        url, headers, body = self._add_client_auth(discovery.token_endpoint, body)
        response = await self._send("POST", url, headers=headers, data=body)
        tokens = response.body
        if response.status >= 500 or not isinstance(tokens, dict):
            raise self._unavailable(f"it answered with status {response.status}")
        if response.status != 200:
            raise self._refused(f"it did not accept its own code ({str(tokens.get('error'))[:60]})")
        return tokens

    def _add_client_auth(self, url: str, body: str) -> tuple[str, dict[str, str], str]:
        """Return a request to the token endpoint with the client's authentication."""
        client_id, secret, method = self.settings.client_id, self._secret, self.settings.client_auth
        if secret is None:
            method = "none"
        elif method == "client_secret_basic":  # form-encoded before they are joined: RFC 6749, section 2.3.1
            client_id, secret = quote_plus(client_id), quote_plus(secret)
        headers = {"Content-Type": _FORM, "Accept": "application/json"}
        prepared: tuple[str, dict[str, str], str] = ClientAuth(client_id, secret, method).prepare(
            "POST", url, headers, body
        )
        return prepared

    async def _verify_id_token(self, id_token: str, nonce: str, access_token: object) -> _Claims:
        token = await self._verify_signature(id_token)
        options = {
            "iss": {"essential": True, "value": self.settings.issuer},
            "aud": {"essential": True, "value": self.settings.client_id},
        }
        params = {"nonce": nonce, "client_id": self.settings.client_id, "access_token": access_token}
        claims = CodeIDToken(token.claims, token.header, options, params)
        try:
            claims.validate(int(time.time()), _CLOCK_LEEWAY_S)
            return _Claims.model_validate(token.claims)
        except JoseError as error:
            raise self._refused(f"its ID token is not valid here ({error.error})") from error
        except (ValidationError, TypeError, ValueError) as error:
            raise self._refused("the claims of its ID token are not valid") from error

    async def _verify_signature(self, token: str, *, refetch_s: float = 0.0) -> jwt.Token:
        """Return an ID token or logout token that the provider has signed. Raises SignInRefused.

        If no key fits, they are fetched again, unless that was tried within the last `refetch_s`.
        """
        keys, are_fresh = await self._get_keys()
        verified = self._decode(token, keys)
        if verified is None and not are_fresh and time.monotonic() >= self._keys_requested_at + refetch_s:
            verified = self._decode(token, await self._fetch_keys())  # the provider may have rotated its keys
        if verified is None:
            raise self._refused("the signature of its ID token is not valid")
        return verified

    def _decode(self, token: str, keys: KeySet) -> jwt.Token | None:
        """Return a token, or None if none of the keys has signed it. Raises SignInRefused if it is malformed."""
        try:
            return jwt.decode(token, keys, algorithms=_ALGORITHMS)
        except (InvalidKeyIdError, BadSignatureError):
            return None
        except (JoseError, ValueError, TypeError) as error:  # joserfc: TypeError for a header `crit` that is no list
            raise self._refused("its ID token is malformed") from error

    async def _get_keys(self) -> tuple[KeySet, bool]:
        """Return the provider's keys, and whether they were fetched just now."""
        if self._keys is not None and self._keys[0] > time.monotonic():
            return self._keys[1], False
        return await self._fetch_keys(), True

    async def _fetch_keys(self) -> KeySet:
        self._keys_requested_at = time.monotonic()
        discovery = await self._discover()
        published: Any = await self._get(discovery.jwks_uri)
        try:
            keys: KeySet = KeySet.import_key_set(published)
        except (JoseError, ValueError, TypeError, KeyError) as error:
            raise self._unavailable("its keys cannot be read") from error
        self._keys = (time.monotonic() + _CACHE_S, keys)
        return keys

    async def _add_userinfo(self, discovery: DiscoveryDocument, claims: _Claims, access_token: str) -> _Claims:
        if discovery.userinfo_endpoint is None:
            return claims
        body = await self._get(discovery.userinfo_endpoint, {"Authorization": f"Bearer {access_token}"})
        userinfo = self._parse(body, _Claims)
        if userinfo.sub != claims.sub:
            raise self._refused("its ID token and its user info name different people")
        return userinfo.model_copy(update={"name": userinfo.name or claims.name})

    async def _get(self, url: str, headers: Mapping[str, str] | None = None) -> JsonValue:
        response = await self._send("GET", url, headers={"Accept": "application/json", **(headers or {})})
        if response.status != 200:
            raise self._unavailable(f"it answered with status {response.status}")
        return response.body

    async def _send(self, method: str, url: str, *, headers: Mapping[str, str], data: str | None = None) -> _Response:
        timeout = aiohttp.ClientTimeout(total=self.settings.timeout_s)
        try:
            async with self._http.request(
                method, url, headers=headers, data=data, timeout=timeout, allow_redirects=False
            ) as response:
                return _Response(response.status, _parse_json(await response.read()))
        except asyncio.TimeoutError as error:
            raise self._unavailable(f"it did not answer within {self.settings.timeout_s:g} s") from error
        except (aiohttp.ClientError, ValueError) as error:
            raise self._unavailable(f"it cannot be reached ({type(error).__name__})") from error

    def _parse(self, body: JsonValue, model: type[T]) -> T:
        try:
            return model.model_validate(body)
        except ValidationError as error:
            raise self._unavailable("its response is not valid") from error

    def _unavailable(self, reason: str) -> ProviderUnavailable:
        return ProviderUnavailable(provider=self.settings.title, reason=reason)

    def _refused(self, reason: str) -> SignInRefused:
        return SignInRefused(reason=f"{self.settings.title} could not confirm who you are: {reason}. Start again.")


def _parse_json(body: bytes) -> JsonValue:
    try:
        parsed: JsonValue = json.loads(body)
    except (ValueError, RecursionError):
        return None
    return parsed
