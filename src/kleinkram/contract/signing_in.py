"""Signing in from a terminal, and who one is: by a browser on the same machine, or by a code typed elsewhere.

By a browser (RFC 8252, RFC 7636): klein listens on 127.0.0.1 and opens
`{public_url}/sign-in/cli?port=…&state=…&code_challenge=…&client=…` (S256); once the person has agreed, the page sends
the browser to `http://127.0.0.1:{port}/?code=…&state=…`, else to `…/?error=denied&state=…`. `POST /auth/cli/token`
exchanges the code. By a code (RFC 8628): `POST /auth/device`, then `POST /auth/device/token` every `interval_s`, which
fails with SignInPending, SlowDown, SignInDenied or SignInExpired until it answers. Both make a personal token.
"""

import datetime
import enum
import uuid
from typing import Annotated

from pydantic import AfterValidator, Field

from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import Scope
from kleinkram.contract.wire import Request, Response


def check_client_name(name: str) -> str:
    """Return what a program calls itself, or say why it cannot.

    Raises:
        ValueError: it has nothing in it to read, or holds what would change how the text around it reads.
    """
    if not name.isprintable() or not name.strip():
        raise ValueError("is empty, or holds what cannot be printed")
    return name


# What the person who agrees reads, and what their new token is called: "klein on anymal-3".
ClientName = Annotated[str, AfterValidator(check_client_name), Field(min_length=1, max_length=100)]
# Unreserved characters, as RFC 7636 wants them.
_Unguessable = Annotated[str, Field(min_length=20, max_length=200, pattern=r"^[A-Za-z0-9._~-]+$")]


class DeviceBegin(Request):
    """Ask for a code that can be typed on another machine: `POST /auth/device`."""

    client: ClientName = "klein"


class DeviceCode(Response):
    """Where to type which code, and how to ask whether it was."""

    device_code: str
    user_code: str
    verification_url: str
    verification_url_complete: str
    interval_s: float
    expires_s: float


class DeviceExchange(Request):
    """Ask whether the code was typed: `POST /auth/device/token`."""

    device_code: _Unguessable


class CliExchange(Request):
    """Exchange what the browser brought for a token: `POST /auth/cli/token`. A code is good for once."""

    code: _Unguessable
    code_verifier: Annotated[str, Field(min_length=43, max_length=128, pattern=r"^[A-Za-z0-9._~-]+$")]


class SignedIn(Response):
    """A new token, told this once, and whose it is."""

    token: str
    person: PersonRef
    expires_at: datetime.datetime | None


class CredentialKind(str, enum.Enum):
    """What somebody came with."""

    session = "session"
    personal = "personal"
    robot = "robot"
    runner = "runner"
    run = "run"


class CredentialRead(Response):
    """The token or browser session of this very request. `is_limited`: it reaches certain projects or missions only.

    `DELETE /tokens/{id}` ends a token, `DELETE /me/sessions/{id}` a session.
    """

    id: uuid.UUID
    kind: CredentialKind
    name: str
    scopes: list[Scope]
    is_limited: bool
    expires_at: datetime.datetime | None


class MeRead(Response):
    """Who the server takes the caller for: `GET /me`. `is_admin`: with the power of an admin, by this credential."""

    person: PersonRef
    emails: list[str]
    groups: list[str]
    is_admin: bool
    credential: CredentialRead


class SessionRead(Response):
    """A browser that one is signed in with: `GET /me/sessions`; `DELETE /me/sessions/{id}` signs it out."""

    id: uuid.UUID
    method: str
    address: str | None
    user_agent: str | None
    created_at: datetime.datetime
    last_used_at: datetime.datetime
    expires_at: datetime.datetime
    is_current: bool
