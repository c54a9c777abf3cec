"""OpenID Connect: authorization code with PKCE, discovery, and ID tokens whose signature and claims are checked.

The protocol's cryptography is Authlib's and joserfc's. What a provider said of itself and its keys is kept for a while;
its keys are fetched again when a token is signed by one that is not among them. Nothing of a token is ever logged.
"""

import time
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar
from urllib.parse import quote_plus

import httpx
from authlib.oauth2.auth import ClientAuth
from authlib.oauth2.rfc6749.parameters import prepare_grant_uri, prepare_token_request
from authlib.oauth2.rfc7636 import create_s256_code_challenge
from authlib.oidc.core.claims import CodeIDToken
from joserfc import jwt
from joserfc.errors import BadSignatureError, InvalidKeyIdError, JoseError
from joserfc.jwk import KeySet
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from kleinkram.contract.errors import ProviderUnavailable, SignInRefused
from kleinkram.contract.names import check_text
from kleinkram.server.auth.providers import Challenge, Vouched
from kleinkram.server.settings import OidcProvider

T = TypeVar("T", bound=BaseModel)

# Signatures that only the provider can make; never one by a secret that we share with it, never none.
_ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "Ed25519")
_KEPT_S = 3600.0
# How far its clock may be from ours.
_LEEWAY_S = 60
_DISCOVERY = "/.well-known/openid-configuration"
_FORM = "application/x-www-form-urlencoded"


class Discovered(BaseModel):
    """What a provider says of itself. Source: OpenID Connect Discovery 1.0, section 3."""

    model_config = ConfigDict(frozen=True)

    issuer: str
    authorization_endpoint: str
    token_endpoint: str
    jwks_uri: str
    userinfo_endpoint: str | None = None

    @property
    def urls(self) -> list[str]:
        """Where it is asked, or sends people."""
        endpoints = self.authorization_endpoint, self.token_endpoint, self.jwks_uri, self.userinfo_endpoint
        return [url for url in endpoints if url is not None]


class _Claims(BaseModel):
    """Of the claims, those that are used. Source: OpenID Connect Core 1.0, sections 2 and 5.1."""

    # Kept as they are, so only what a database keeps; of this length at most by the standard's word.
    sub: Annotated[str, Field(min_length=1, max_length=255), AfterValidator(check_text)]
    email: Annotated[str, AfterValidator(check_text)] | None = None
    # Some providers write it as text.
    email_verified: bool | str | None = None
    name: str | None = None
    preferred_username: str | None = None
    auth_time: int | None = None


class OpenIdProvider:
    """One provider, as it answers now."""

    def __init__(
        self, settings: OidcProvider, web: httpx.AsyncClient, *, redirect_url: str, secret: str | None
    ) -> None:
        self.settings = settings
        self._web = web
        self._secret = secret
        self._redirect_url = redirect_url
        self._discovered: tuple[float, Discovered] | None = None
        self._keys: tuple[float, KeySet] | None = None

    async def authorization_url(self, challenge: Challenge, *, again: bool = False) -> str:
        """Return where the browser goes, with state, nonce and the challenge of PKCE.

        Source of `prompt` and `max_age`: OpenID Connect Core 1.0, section 3.1.2.1.
        """
        discovered = await self._discover()
        anew = {"prompt": "login", "max_age": "0"} if again else {}
        url: str = prepare_grant_uri(
            discovered.authorization_endpoint,
            client_id=self.settings.client_id,
            response_type="code",
            redirect_uri=self._redirect_url,
            scope=list(self.settings.scopes),
            state=challenge.state,
            nonce=challenge.nonce,
            code_challenge=create_s256_code_challenge(challenge.code_verifier),
            code_challenge_method="S256",
            **anew,
        )
        return url

    async def vouch(self, code: str, challenge: Challenge) -> Vouched:
        """Exchange a code for an ID token and return whom that names."""
        discovered = await self._discover()
        tokens = await self._exchange(discovered, code, challenge)
        id_token, access_token = tokens.get("id_token"), tokens.get("access_token")
        if not isinstance(id_token, str):
            raise self._unbelievable("it sent no ID token")
        claims = await self._verified(id_token, challenge.nonce, access_token)
        if claims.email is None and isinstance(access_token, str):
            claims = await self._with_userinfo(discovered, claims, access_token)
        return Vouched(
            issuer=self.settings.issuer,
            subject=claims.sub,
            email=claims.email,
            email_verified=claims.email_verified in {True, "true"},
            name=claims.name or claims.preferred_username,
            auth_time=claims.auth_time,
        )

    async def _discover(self) -> Discovered:
        if self._discovered is not None and self._discovered[0] > time.monotonic():
            return self._discovered[1]
        answer = await self._get(self.settings.issuer.rstrip("/") + _DISCOVERY)
        discovered = self._understood(answer, Discovered)
        if discovered.issuer != self.settings.issuer:
            raise self._unavailable(f"it calls itself {discovered.issuer[:200]!r}, not as the settings say")
        if self.settings.issuer.startswith("https:") and not all(url.startswith("https:") for url in discovered.urls):
            raise self._unavailable("it wants to be asked without TLS")
        self._discovered = (time.monotonic() + _KEPT_S, discovered)
        return discovered

    async def _exchange(self, discovered: Discovered, code: str, challenge: Challenge) -> dict[str, Any]:
        body = prepare_token_request(
            "authorization_code", code=code, redirect_uri=self._redirect_url, code_verifier=challenge.code_verifier
        )
        url, headers, body = self._authenticated(discovered.token_endpoint, body)
        answer = await self._ask("POST", url, headers=headers, content=body)
        tokens: Any = _json(answer)
        if answer.status_code >= 500 or not isinstance(tokens, dict):
            raise self._unavailable(f"it answered with status {answer.status_code}")
        if answer.status_code != 200:
            error = tokens.get("error")
            raise self._unbelievable(f"it did not accept its own code ({str(error)[:60]})")
        return tokens

    async def _verified(self, id_token: str, nonce: str, access_token: object) -> _Claims:
        token = await self._with_valid_signature(id_token)
        options = {
            "iss": {"essential": True, "value": self.settings.issuer},
            "aud": {"essential": True, "value": self.settings.client_id},
        }
        params = {"nonce": nonce, "client_id": self.settings.client_id, "access_token": access_token}
        claims = CodeIDToken(token.claims, token.header, options, params)
        try:
            claims.validate(int(time.time()), _LEEWAY_S)
            return _Claims.model_validate(token.claims)
        except JoseError as error:
            raise self._unbelievable(f"its ID token is not good here ({error.error})") from error
        except (ValidationError, TypeError, ValueError) as error:
            raise self._unbelievable("its ID token cannot be understood") from error

    async def _with_valid_signature(self, id_token: str) -> jwt.Token:
        keys, are_fresh = await self._get_keys()
        try:
            return jwt.decode(id_token, keys, algorithms=_ALGORITHMS)
        except (InvalidKeyIdError, BadSignatureError) as error:
            if are_fresh:
                raise self._unbelievable("nobody knows who signed its ID token") from error
        except (JoseError, ValueError) as error:
            raise self._unbelievable("its ID token is not one") from error
        self._keys = None  # it may have changed them since
        return await self._with_valid_signature(id_token)

    async def _get_keys(self) -> tuple[KeySet, bool]:
        """Return its keys, and whether they were fetched just now."""
        if self._keys is not None and self._keys[0] > time.monotonic():
            return self._keys[1], False
        discovered = await self._discover()
        published = _json(await self._get(discovered.jwks_uri))
        try:
            keys = KeySet.import_key_set(published)
        except (JoseError, ValueError, TypeError, KeyError) as error:
            raise self._unavailable("its keys cannot be read") from error
        self._keys = (time.monotonic() + _KEPT_S, keys)
        return keys, True

    async def _with_userinfo(self, discovered: Discovered, claims: _Claims, access_token: str) -> _Claims:
        """Return the claims with those that the provider tells only when it is asked for them."""
        if discovered.userinfo_endpoint is None:
            return claims
        headers = {"Authorization": f"Bearer {access_token}"}
        answer = await self._get(discovered.userinfo_endpoint, headers=headers)
        told = self._understood(answer, _Claims)
        if told.sub != claims.sub:
            raise self._unbelievable("it speaks of two people at once")
        return told.model_copy(update={"name": told.name or claims.name})

    async def _get(self, url: str, headers: Mapping[str, str] | None = None) -> httpx.Response:
        answer = await self._ask("GET", url, headers={"Accept": "application/json", **(headers or {})})
        if answer.status_code != 200:
            raise self._unavailable(f"it answered with status {answer.status_code}")
        return answer

    async def _ask(self, method: str, url: str, **how: Any) -> httpx.Response:
        try:
            return await self._web.request(method, url, timeout=self.settings.timeout_s, **how)
        except httpx.TimeoutException as error:
            raise self._unavailable(f"it did not answer within {self.settings.timeout_s:g} s") from error
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise self._unavailable(f"it cannot be reached ({type(error).__name__})") from error

    def _authenticated(self, url: str, body: str) -> tuple[str, dict[str, str], str]:
        """Return a request to the token endpoint with what proves that it is ours."""
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

    def _understood(self, answer: httpx.Response, kind: type[T]) -> T:
        try:
            return kind.model_validate(_json(answer))
        except ValidationError as error:
            raise self._unavailable("its answer cannot be understood") from error

    def _unavailable(self, reason: str) -> ProviderUnavailable:
        return ProviderUnavailable(provider=self.settings.title, reason=reason)

    def _unbelievable(self, reason: str) -> SignInRefused:
        return SignInRefused(reason=f"{self.settings.title} could not say who you are: {reason}. Begin again.")


def _json(answer: httpx.Response) -> Any:
    try:
        return answer.json()
    except (ValueError, RecursionError):
        return None
