"""The server cannot answer now."""

from dataclasses import dataclass

from kleinkram.contract.errors.base import ErrorCode, KleinkramError


@dataclass(eq=False)
class RateLimited(KleinkramError):
    """That was too often: at most {most} {what} in {per_s} s are allowed. Try again in {retry_after_s} s."""

    code = ErrorCode.rate_limited
    status = 429
    what: str
    most: int
    per_s: int
    retry_after_s: int


@dataclass(eq=False)
class TooManyStreams(KleinkramError):
    """Your account has {most} streams or waiting requests open, which is the limit. Close a page or a program."""

    code = ErrorCode.too_many_streams
    status = 429
    most: int


@dataclass(eq=False)
class StoreUnavailable(KleinkramError):
    """The object store cannot be used ({reason}). Nothing was lost; try again in a moment."""

    code = ErrorCode.store_unavailable
    status = 503
    reason: str


@dataclass(eq=False)
class DatabaseUnavailable(KleinkramError):
    """The database cannot be used ({reason}). Nothing was lost; try again in a moment."""

    code = ErrorCode.database_unavailable
    status = 503
    reason: str = "it does not answer"


@dataclass(eq=False)
class InternalError(KleinkramError):
    """The server failed in a way it should not. Give the request id {request_id} to whoever runs it."""

    code = ErrorCode.internal_error
    status = 500
    request_id: str
