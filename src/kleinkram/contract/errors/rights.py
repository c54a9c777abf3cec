"""Somebody may not do that, or a rule about people and groups forbids it."""

from dataclasses import dataclass

from kleinkram.contract.errors.base import ErrorCode, KleinkramError


@dataclass(eq=False)
class Forbidden(KleinkramError):
    """You may not {operation} here: on this {noun} that takes {needs}. Ask one of its owners."""

    code = ErrorCode.forbidden
    status = 403
    noun: str
    operation: str
    needs: str


@dataclass(eq=False)
class ScopeMissing(KleinkramError):
    """What you came with does not allow to {operation}: that takes {scopes}. Use another token, or sign in."""

    code = ErrorCode.scope_missing
    status = 403
    operation: str
    scopes: str


@dataclass(eq=False)
class TokenTooWide(KleinkramError):
    """A token cannot make one that may do more than itself: {reason}. Sign in to make that one."""

    code = ErrorCode.token_too_wide
    status = 403
    reason: str


@dataclass(eq=False)
class RightExceeded(KleinkramError):
    """You may not give {wanted} on this {noun}: you hold {held} there. Nobody gives more, or for longer, than they hold."""  # noqa: E501  one sentence

    code = ErrorCode.right_exceeded
    status = 403
    noun: str
    wanted: str
    held: str


@dataclass(eq=False)
class LastOwner(KleinkramError):
    """That would leave {listing} without a lasting owner: somebody active who has DELETE without an end, not by an e-mail address. Give that to somebody else first."""  # noqa: E501  one sentence

    code = ErrorCode.last_owner
    status = 409
    projects: list[str]

    @property
    def listing(self) -> str:
        """The projects, as a person reads them."""
        return ", ".join(repr(name) for name in self.projects)


@dataclass(eq=False)
class LastAdmin(KleinkramError):
    """That would leave this server without a lasting admin: somebody active who is one without an end. Make somebody else one first."""  # noqa: E501  one sentence

    code = ErrorCode.last_admin
    status = 409


@dataclass(eq=False)
class GroupFixed(KleinkramError):
    """The group {name!r} cannot be changed like that: {reason}."""

    code = ErrorCode.group_fixed
    status = 409
    name: str
    reason: str
