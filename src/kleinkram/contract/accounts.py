"""Signing in from a terminal, and who one is: by a browser on the same machine, or by a code typed elsewhere.

By a browser (RFC 8252, RFC 7636): klein listens on 127.0.0.1 and opens
`{public_url}/sign-in/cli?port=…&state=…&code_challenge=…&client=…` (S256); once the person has agreed, the page sends
the browser to `http://127.0.0.1:{port}/?code=…&state=…`, else to `…/?error=denied&state=…`. `POST /auth/cli/token`
exchanges the code. By a code (RFC 8628): `POST /auth/device`, then `POST /auth/device/token` every `interval_s`, which
fails with SignInPending, SlowDown, SignInDenied or SignInExpired until it answers. Both make a personal token.
"""

import datetime
import enum
import unicodedata
import uuid
from typing import Annotated

from pydantic import AfterValidator, Field

from kleinkram.contract.access import Scope
from kleinkram.contract.base import Request, Response
from kleinkram.contract.names import check_text
from kleinkram.contract.people import EmailAddress, PersonRef


def check_client_name(name: str) -> str:
    """Return what a program calls itself, or say why it cannot. Raises ValueError."""
    if not name.isprintable() or not name.strip():
        raise ValueError("is empty, or holds what cannot be printed")
    return name


# What the person who agrees reads, and what their new token is called: "klein on anymal-3".
ClientName = Annotated[str, AfterValidator(check_client_name), Field(min_length=1, max_length=100)]
# Unreserved characters, as RFC 7636 wants them.
_UnguessableText = Annotated[str, Field(min_length=20, max_length=200, pattern=r"^[A-Za-z0-9._~-]+$")]


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

    device_code: _UnguessableText


class CliExchange(Request):
    """Exchange what the browser brought for a token: `POST /auth/cli/token`. A code is good for once."""

    code: _UnguessableText
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


MIN_PASSWORD_CHARACTERS = 10
MAX_PASSWORD_CHARACTERS = 256
MAX_PERSON_NAME_CHARACTERS = 128


def check_person_name(name: str) -> str:
    """Return somebody's name in NFC, or say why it cannot be one. Raises ValueError."""
    name = unicodedata.normalize("NFC", name)
    if not name or name != name.strip() or not name.isprintable():
        raise ValueError("is empty, begins or ends with a space, or holds what cannot be printed")
    return name


PersonName = Annotated[
    str, AfterValidator(check_person_name), Field(min_length=1, max_length=MAX_PERSON_NAME_CHARACTERS)
]
NewPassword = Annotated[
    str,
    AfterValidator(check_text),
    Field(min_length=MIN_PASSWORD_CHARACTERS, max_length=MAX_PASSWORD_CHARACTERS),
]
# One that is only compared: whether it could be somebody's is no question of its form.
GivenPassword = Annotated[str, AfterValidator(check_text), Field(max_length=MAX_PASSWORD_CHARACTERS)]
# A code of an authenticator app, or a recovery code; spaces and hyphens in it are nobody's business.
SecondFactor = Annotated[str, AfterValidator(check_text), Field(min_length=6, max_length=40)]
OneTimeCode = Annotated[str, Field(min_length=20, max_length=100, pattern=r"^[A-Za-z0-9_-]+$")]
UserCode = Annotated[str, Field(min_length=8, max_length=20, pattern=r"^[A-Za-z -]+$")]
# A path of this server, to go to after signing in.
ReturnTo = Annotated[str, Field(max_length=2000, pattern=r"^/($|[^/\\\x00-\x1f\x7f][^\\\x00-\x1f\x7f]*$)")]


class ProviderRef(Response):
    """Somebody who says who people are; `name` is what requests call them."""

    name: str
    title: str


class SignInMethods(Response):
    """The sign-in methods of a server: `GET /auth/methods`. `bootstrap`: it has no admin yet."""

    password: bool
    providers: list[ProviderRef]
    bootstrap: bool


class PasswordSignIn(Request):
    """Sign in with a local account: `POST /auth/password`. `second_factor`: of an account that has one."""

    email: Annotated[str, AfterValidator(check_text), Field(max_length=254)]
    password: GivenPassword = Field(repr=False)
    second_factor: SecondFactor | None = Field(default=None, repr=False)


class PasswordReauthenticate(Request):
    """Enter the password again in a signed-in browser: `POST /auth/password/reauthenticate`."""

    password: GivenPassword = Field(repr=False)
    second_factor: SecondFactor | None = Field(default=None, repr=False)


class TotpConfirm(Request):
    """Take a second factor into use, by a code of it: `POST /me/totp/confirm`."""

    code: SecondFactor = Field(repr=False)


class TotpEnrolment(Response):
    """A secret for an authenticator app, as text, as `otpauth:` address, and as a picture (a `data:` address)."""

    secret: str = Field(repr=False)
    url: str = Field(repr=False)
    qr: str = Field(repr=False)


class RecoveryCodes(Response):
    """What stands for a code where the device is lost: each is good once, and nobody can show them again."""

    codes: list[str] = Field(repr=False)


class TotpRead(Response):
    """A second factor that is in use."""

    enabled_at: datetime.datetime
    recovery_codes_left: int


class CodeSignIn(Request):
    """Sign in by a link that is good once: `POST /auth/link`."""

    code: OneTimeCode = Field(repr=False)


class AdminBootstrap(Request):
    """Become the first admin of a new server: `POST /auth/bootstrap`. A signed-in person sends only the code."""

    code: OneTimeCode = Field(repr=False)
    name: PersonName | None = None
    email: EmailAddress | None = None
    password: NewPassword | None = Field(default=None, repr=False)


class InvitationAccept(Request):
    """Get the account that one is invited to: `POST /auth/invitation`."""

    code: OneTimeCode = Field(repr=False)
    name: PersonName | None = None
    password: NewPassword = Field(repr=False)


class PasswordReset(Request):
    """Choose a new password by an admin's link: `POST /auth/reset`."""

    code: OneTimeCode = Field(repr=False)
    password: NewPassword = Field(repr=False)
    second_factor: SecondFactor | None = Field(default=None, repr=False)


class PasswordChange(Request):
    """Choose a new password: `POST /auth/password/change`. Other browsers are signed out."""

    old_password: GivenPassword = Field(repr=False)
    new_password: NewPassword = Field(repr=False)


class ProviderBegin(Request):
    """Begin to sign in by a provider: `POST /auth/providers/{name}`; `POST /auth/link/{name}` to add it to oneself."""

    return_to: ReturnTo = "/"


class ProviderBegun(Response):
    """Where the browser goes next."""

    url: str


class CodeRead(Response):
    """For whom a link is: `POST /auth/codes`. Asking does not use it."""

    purpose: str
    name: str | None
    email: str | None


class OneTimeLink(Response):
    """A link that is good once, until then. `warning`: what its use changes for others, and what to do before."""

    url: str = Field(repr=False)
    expires_at: datetime.datetime
    warning: str | None = None


class InvitationCreate(Request):
    """Invite somebody to an account: `POST /people/invitations`. That the address is theirs is the word of who does."""

    email: EmailAddress
    name: PersonName | None = None


class LoopbackApproval(Request):
    """Agree that a program on this machine gets a token: `POST /auth/cli/approve`. It listens on 127.0.0.1:`port`."""

    port: Annotated[int, Field(ge=1, le=65535)]
    state: Annotated[str, Field(min_length=8, max_length=200, pattern=r"^[A-Za-z0-9._~-]+$")]
    code_challenge: Annotated[str, Field(min_length=43, max_length=43, pattern=r"^[A-Za-z0-9_-]+$")]
    client: ClientName = "klein"


class LoopbackApproved(Response):
    """Where the browser brings the code."""

    url: str = Field(repr=False)


class DeviceDecision(Request):
    """Agree or disagree that the program that shows this code gets a token: `POST /auth/device/approve` or `/deny`."""

    user_code: UserCode


class DeviceRead(Response):
    """Who asks by a code: `POST /auth/device/status`."""

    client: str
    address: str | None
    created_at: datetime.datetime
    expires_at: datetime.datetime


class AddressRead(Response):
    """An address that is one's own; `verified_by` says by whose word: an issuer's URL, or how one came by it here."""

    email: str
    verified_at: datetime.datetime
    verified_by: str


class AccountRead(Response):
    """One's own account: `GET /me/account`. `affiliations` are the groups that one is in by an address.

    `totp`: the second factor beside the password, where one is in use.
    `has_password`: that one may sign in with; none is kept here of who comes by a provider alone.
    """

    person: PersonRef
    addresses: list[AddressRead]
    affiliations: list[str]
    has_password: bool
    totp: TotpRead | None = None
    created_at: datetime.datetime


class IdentityRead(Response):
    """Under whose word one signs in: `GET /me/identities`; `DELETE /me/identities/{id}` unlinks it.

    `provider` is its title, null where this server has it no more. `is_last`: without it there would be no way in.
    """

    id: uuid.UUID
    issuer: str
    provider: str | None
    is_last: bool
    email: str | None
    created_at: datetime.datetime
    last_used_at: datetime.datetime


class BrowserSignedIn(Response):
    """Who a browser is signed in as, from now on; the session itself is in a cookie that no script can read."""

    person: PersonRef
