"""Accounts, sessions, and sign-in: with a browser, from a terminal, with passwords and one-time links.

With a browser (RFC 8252, RFC 7636): klein listens on 127.0.0.1 and opens
`{public_url}/sign-in/cli?port=…&state=…&code_challenge=…&client=…` (S256); once the person has agreed, the page sends
the browser to `http://127.0.0.1:{port}/?code=…&state=…`, otherwise to `…/?error=denied&state=…`. `POST /auth/cli/token`
exchanges the code. With a code (RFC 8628): `POST /auth/device`, then `POST /auth/device/token` every `interval_s`,
which fails with SignInPending, SlowDown, SignInDenied or SignInExpired until the person has agreed. Both create a
personal token.
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
    """Return the name of a program. Raises ValueError."""
    if not name.isprintable() or not name.strip():
        raise ValueError("is empty, or contains unprintable characters")
    return name


# Shown to the person who approves, and the name of the new token: "klein on anymal-3".
ClientName = Annotated[str, AfterValidator(check_client_name), Field(min_length=1, max_length=100)]
# Unreserved characters (RFC 7636).
_UnguessableText = Annotated[str, Field(min_length=20, max_length=200, pattern=r"^[A-Za-z0-9._~-]+$")]


class DeviceBegin(Request):
    """Request a code to type on another machine: `POST /auth/device`."""

    client: ClientName = "klein"


class DeviceCode(Response):
    """The code to type, where, and how to poll for the result."""

    device_code: str
    user_code: str
    verification_url: str
    verification_url_complete: str
    interval_s: float
    expires_s: float


class DeviceExchange(Request):
    """Poll for the result: `POST /auth/device/token`."""

    device_code: _UnguessableText


class CliExchange(Request):
    """Exchange the code from the browser for a token: `POST /auth/cli/token`. A code is valid once."""

    code: _UnguessableText
    code_verifier: Annotated[str, Field(min_length=43, max_length=128, pattern=r"^[A-Za-z0-9._~-]+$")]


class SignedIn(Response):
    """A new token, shown only once, and its person."""

    token: str
    person: PersonRef
    expires_at: datetime.datetime | None


class CredentialKind(str, enum.Enum):
    """The kind of a credential."""

    session = "session"
    personal = "personal"
    robot = "robot"
    runner = "runner"
    run = "run"


class CredentialRead(Response):
    """The token or browser session of this request. `is_limited`: it reaches only some projects or missions.

    `DELETE /tokens/{id}` ends a token, `DELETE /me/sessions/{id}` a session.
    """

    id: uuid.UUID
    kind: CredentialKind
    name: str
    scopes: list[Scope]
    is_limited: bool
    expires_at: datetime.datetime | None


class MeRead(Response):
    """The caller: `GET /me`. `is_admin`: with admin rights, by this credential."""

    person: PersonRef
    emails: list[str]
    groups: list[str]
    is_admin: bool
    credential: CredentialRead


class SessionRead(Response):
    """A browser in which you are signed in: `GET /me/sessions`; `DELETE /me/sessions/{id}` signs it out."""

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
    """Return a person's name in NFC. Raises ValueError."""
    name = unicodedata.normalize("NFC", name)
    if not name or name != name.strip() or not name.isprintable():
        raise ValueError("is empty, begins or ends with a space, or contains unprintable characters")
    return name


PersonName = Annotated[
    str, AfterValidator(check_person_name), Field(min_length=1, max_length=MAX_PERSON_NAME_CHARACTERS)
]
NewPassword = Annotated[
    str,
    AfterValidator(check_text),
    Field(min_length=MIN_PASSWORD_CHARACTERS, max_length=MAX_PASSWORD_CHARACTERS),
]
# Only compared, so its form is not checked.
EnteredPassword = Annotated[str, AfterValidator(check_text), Field(max_length=MAX_PASSWORD_CHARACTERS)]
# A code of an authenticator app, or a recovery code; spaces and hyphens are ignored.
SecondFactor = Annotated[str, AfterValidator(check_text), Field(min_length=6, max_length=40)]
OneTimeCode = Annotated[str, Field(min_length=20, max_length=100, pattern=r"^[A-Za-z0-9_-]+$")]
UserCode = Annotated[str, Field(min_length=8, max_length=20, pattern=r"^[A-Za-z -]+$")]
# A path of this server to open after signing in.
ReturnTo = Annotated[str, Field(max_length=2000, pattern=r"^/($|[^/\\\x00-\x1f\x7f][^\\\x00-\x1f\x7f]*$)")]


class ProviderRef(Response):
    """An identity provider; `name` is its id in requests."""

    name: str
    title: str


class SignInMethods(Response):
    """The sign-in methods of a server: `GET /auth/methods`. `bootstrap`: it has no admin yet."""

    password: bool
    providers: list[ProviderRef]
    bootstrap: bool


class PasswordSignIn(Request):
    """Sign in with a local account: `POST /auth/password`. `second_factor`: if the account has one."""

    email: Annotated[str, AfterValidator(check_text), Field(max_length=254)]
    password: EnteredPassword = Field(repr=False)
    second_factor: SecondFactor | None = Field(default=None, repr=False)


class PasswordReauthenticate(Request):
    """Enter the password again in a signed-in browser: `POST /auth/password/reauthenticate`."""

    password: EnteredPassword = Field(repr=False)
    second_factor: SecondFactor | None = Field(default=None, repr=False)


class TotpConfirm(Request):
    """Confirm a second factor with one of its codes: `POST /me/totp/confirm`."""

    code: SecondFactor = Field(repr=False)


class TotpEnrolment(Response):
    """A secret for an authenticator app: as text, `otpauth:` URL, and QR code (a `data:` URL)."""

    secret: str = Field(repr=False)
    url: str = Field(repr=False)
    qr: str = Field(repr=False)


class RecoveryCodes(Response):
    """Recovery codes for a lost device: each is valid once, and they cannot be shown again."""

    codes: list[str] = Field(repr=False)


class TotpRead(Response):
    """A confirmed second factor."""

    enabled_at: datetime.datetime
    recovery_codes_left: int


class CodeSignIn(Request):
    """Sign in with a one-time link: `POST /auth/link`."""

    code: OneTimeCode = Field(repr=False)


class AdminBootstrap(Request):
    """Become the first admin of a new server: `POST /auth/bootstrap`. Signed-in people send only the code."""

    code: OneTimeCode = Field(repr=False)
    name: PersonName | None = None
    email: EmailAddress | None = None
    password: NewPassword | None = Field(default=None, repr=False)


class InvitationAccept(Request):
    """Create the account of an invitation: `POST /auth/invitation`."""

    code: OneTimeCode = Field(repr=False)
    name: PersonName | None = None
    password: NewPassword = Field(repr=False)


class PasswordReset(Request):
    """Choose a new password with a reset link: `POST /auth/reset`."""

    code: OneTimeCode = Field(repr=False)
    password: NewPassword = Field(repr=False)
    second_factor: SecondFactor | None = Field(default=None, repr=False)


class PasswordChange(Request):
    """Change your password: `POST /auth/password/change`. Your other browsers are signed out."""

    old_password: EnteredPassword = Field(repr=False)
    new_password: NewPassword = Field(repr=False)


class ProviderBegin(Request):
    """Start a sign-in with a provider: `POST /auth/providers/{name}`, or `…/link` to link it to your account."""

    return_to: ReturnTo = "/"


class ProviderBegun(Response):
    """The URL to which the browser goes next."""

    url: str


class CodeRead(Response):
    """Purpose and recipient of a link: `POST /auth/codes`. The request does not use the link."""

    purpose: str
    name: str | None
    email: str | None


class OneTimeLink(Response):
    """A one-time link. `warning`: what its use changes for others, and what to do before."""

    url: str = Field(repr=False)
    expires_at: datetime.datetime
    warning: str | None = None


class InvitationCreate(Request):
    """Invite a person: `POST /people/invitations`. You vouch for the address."""

    email: EmailAddress
    name: PersonName | None = None


class LoopbackApproval(Request):
    """Approve a token for a program on this machine, which listens on 127.0.0.1:`port`: `POST /auth/cli/approve`."""

    port: Annotated[int, Field(ge=1, le=65535)]
    state: Annotated[str, Field(min_length=8, max_length=200, pattern=r"^[A-Za-z0-9._~-]+$")]
    code_challenge: Annotated[str, Field(min_length=43, max_length=43, pattern=r"^[A-Za-z0-9_-]+$")]
    client: ClientName = "klein"


class LoopbackApproved(Response):
    """The URL that delivers the code to the program."""

    url: str = Field(repr=False)


class DeviceDecision(Request):
    """Approve or deny a token for the program that shows this code: `POST /auth/device/approve` or `/deny`."""

    user_code: UserCode


class DeviceRead(Response):
    """The program that shows a code: `POST /auth/device/status`."""

    client: str
    address: str | None
    created_at: datetime.datetime
    expires_at: datetime.datetime


class AddressRead(Response):
    """A verified address; `verified_by` is the URL of a provider, or how the account was created."""

    email: str
    verified_at: datetime.datetime
    verified_by: str


class AccountRead(Response):
    """Your account: `GET /me/account`. `affiliations` are the groups that follow from your addresses.

    `totp` is the confirmed second factor. `has_password`: you can sign in with a password.
    """

    person: PersonRef
    addresses: list[AddressRead]
    affiliations: list[str]
    has_password: bool
    totp: TotpRead | None = None
    created_at: datetime.datetime


class IdentityRead(Response):
    """A linked identity: `GET /me/identities`; `DELETE /me/identities/{id}` unlinks it.

    `provider` is the title of its provider, null if it left the settings. `is_last`: your last sign-in method.
    """

    id: uuid.UUID
    issuer: str
    provider: str | None
    is_last: bool
    email: str | None
    created_at: datetime.datetime
    last_used_at: datetime.datetime


class BrowserSignedIn(Response):
    """The signed-in person; the session is in a cookie that no script can read."""

    person: PersonRef
