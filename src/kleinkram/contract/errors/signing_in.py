"""Who somebody is could not be told, or they may not come in."""

from dataclasses import dataclass

from kleinkram.contract.errors.base import ErrorCode, KleinkramError


@dataclass(eq=False)
class NotAuthenticated(KleinkramError):
    """The server does not know who you are: {reason}. `klein login {server}` signs in; a robot needs a valid token."""

    code = ErrorCode.not_authenticated
    status = 401
    reason: str
    # How the client reaches the server, which says so itself.
    server: str = "URL"


@dataclass(eq=False)
class SignInPending(KleinkramError):
    """The code has not been typed yet. Type it on the page, or ask again in {interval_s:g} s."""

    code = ErrorCode.sign_in_pending
    status = 400
    interval_s: float


@dataclass(eq=False)
class SlowDown(KleinkramError):
    """That was asked too often. Ask again no sooner than in {interval_s:g} s."""

    code = ErrorCode.slow_down
    status = 429
    interval_s: float


@dataclass(eq=False)
class SignInDenied(KleinkramError):
    """The sign-in was refused on the page. Nothing was kept; `klein login` begins anew."""

    code = ErrorCode.sign_in_denied
    status = 403


@dataclass(eq=False)
class SignInExpired(KleinkramError):
    """The sign-in was not finished in time, or its code has been used. `klein login` begins anew."""

    code = ErrorCode.sign_in_expired
    status = 410


@dataclass(eq=False)
class SignInFailed(KleinkramError):
    """E-mail address and password do not belong together. Try again, or ask an admin for a link to a new password."""

    code = ErrorCode.sign_in_failed
    status = 401


@dataclass(eq=False)
class SignInRefused(KleinkramError):
    """You are not signed in: {reason}"""

    code = ErrorCode.sign_in_refused
    status = 403
    reason: str


@dataclass(eq=False)
class CodeGone(KleinkramError):
    """This link or code is not good (any more): it was used, its time is over, or a newer one took its place. Ask for a new one."""  # noqa: E501  one sentence

    code = ErrorCode.code_gone
    status = 410


@dataclass(eq=False)
class ProviderUnavailable(KleinkramError):
    """{provider} could not be asked who you are: {reason}. Nothing was changed; try again, or sign in another way."""

    code = ErrorCode.provider_unavailable
    status = 503
    provider: str
    reason: str


@dataclass(eq=False)
class LastWayIn(KleinkramError):
    """{provider} stays linked: it is the only way left by which you could sign in. Link another one first, or ask an admin for a link to a password."""  # noqa: E501  one sentence

    code = ErrorCode.last_way_in
    status = 409
    provider: str


@dataclass(eq=False)
class SignInTooOld(KleinkramError):
    """To {operation}, sign in again: that was more than {minutes:g} minutes ago, or is not known of this token. In a browser, the page asks for it; in a terminal, run `klein login` and repeat the command."""  # noqa: E501  one sentence

    code = ErrorCode.sign_in_too_old
    status = 403
    operation: str
    minutes: float


@dataclass(eq=False)
class SecondFactorNeeded(KleinkramError):
    """This account also needs a code from its authenticator app, or one of its recovery codes."""

    code = ErrorCode.second_factor_needed
    status = 401


@dataclass(eq=False)
class SecondFactorWrong(KleinkramError):
    """The code is wrong, was used before, or is too old. Wait for the next one; after {most} wrong codes none is taken for {minutes:g} minutes. An admin can switch the second factor off for you."""  # noqa: E501  one sentence

    code = ErrorCode.second_factor_wrong
    status = 401
    most: int
    minutes: float
