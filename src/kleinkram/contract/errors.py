"""Every failure that can cross the wire: one closed set of codes, one class each.

A class's docstring is its sentence; its fields fill the braces and travel in the problem document (RFC 9457), so the
SDK raises the very class that the server raised. Nobody matches on a message.
"""

import enum
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError


class ErrorCode(str, enum.Enum):
    """The closed set of failures."""

    not_authenticated = "not_authenticated"
    sign_in_pending = "sign_in_pending"
    slow_down = "slow_down"
    sign_in_denied = "sign_in_denied"
    sign_in_expired = "sign_in_expired"
    sign_in_failed = "sign_in_failed"
    sign_in_refused = "sign_in_refused"
    code_gone = "code_gone"
    provider_unavailable = "provider_unavailable"
    rate_limited = "rate_limited"
    too_many_streams = "too_many_streams"
    forbidden = "forbidden"
    scope_missing = "scope_missing"
    token_too_wide = "token_too_wide"  # noqa: S105  the code's name
    right_exceeded = "right_exceeded"
    last_owner = "last_owner"
    last_admin = "last_admin"
    group_fixed = "group_fixed"
    not_found = "not_found"
    ambiguous_name = "ambiguous_name"
    name_taken = "name_taken"
    invalid_request = "invalid_request"
    invalid_query = "invalid_query"
    invalid_cursor = "invalid_cursor"
    yaml_invalid = "yaml_invalid"
    fields_invalid = "fields_invalid"
    metadata_invalid = "metadata_invalid"
    body_too_large = "body_too_large"
    file_exists = "file_exists"
    path_conflict = "path_conflict"
    name_leased = "name_leased"
    upload_gone = "upload_gone"
    upload_incomplete = "upload_incomplete"
    checksum_mismatch = "checksum_mismatch"
    file_unavailable = "file_unavailable"
    quota_exceeded = "quota_exceeded"
    method_not_allowed = "method_not_allowed"
    store_unavailable = "store_unavailable"
    database_unavailable = "database_unavailable"
    internal_error = "internal_error"


class FieldProblem(BaseModel):
    """One thing wrong with one field of a request, a metadata document or a field definition."""

    model_config = ConfigDict(frozen=True)

    field: str
    message: str
    line: int | None = None
    column: int | None = None


@dataclass(eq=False)
class KleinkramError(Exception):
    """Something went wrong."""

    code: ClassVar[ErrorCode]
    status: ClassVar[int]

    def __post_init__(self) -> None:
        """Make `str(error)` the sentence."""
        super().__init__(self.sentence())

    def __str__(self) -> str:
        return self.sentence()

    def sentence(self) -> str:
        """Return what happened, where, and what to do."""
        return (type(self).__doc__ or "").format(**self.__dict__)

    def fields(self) -> dict[str, object]:
        """Return the typed fields as they travel."""
        return asdict(self)


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
    """Your account has {most} streams of events open, which is all that it gets. Close a page, or a program."""

    code = ErrorCode.too_many_streams
    status = 429
    most: int


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

    def sentence(self) -> str:
        """Return the sentence with all projects."""
        return (type(self).__doc__ or "").format(listing=self.listing)


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


@dataclass(eq=False)
class NotFound(KleinkramError):
    """There is no {noun} {ref!r} that you may see."""

    code = ErrorCode.not_found
    status = 404
    noun: str
    ref: str


@dataclass(eq=False)
class AmbiguousName(KleinkramError):
    """{ref!r} names more than one {noun}: {listing}. Say which, by its id or with what holds it."""

    code = ErrorCode.ambiguous_name
    status = 409
    noun: str
    ref: str
    candidates: list[str]

    @property
    def listing(self) -> str:
        """The candidates, as a person reads them."""
        return "; ".join(self.candidates)

    def sentence(self) -> str:
        """Return the sentence with all candidates."""
        return (type(self).__doc__ or "").format(**self.__dict__, listing=self.listing)


@dataclass(eq=False)
class NameTaken(KleinkramError):
    """There already is a {noun} named {name!r} here (names that differ only in case or Unicode form are the same)."""

    code = ErrorCode.name_taken
    status = 409
    noun: str
    name: str


@dataclass(eq=False)
class _ProblemsError(KleinkramError):
    problems: list[FieldProblem]

    def fields(self) -> dict[str, object]:
        return {"problems": [problem.model_dump(exclude_none=True) for problem in self.problems]}

    def sentence(self) -> str:
        listing = "; ".join(f"{problem.field}: {problem.message}" for problem in self.problems)
        return f"{type(self).__doc__} {listing}"


@dataclass(eq=False)
class InvalidRequest(_ProblemsError):
    """The request is not as the API wants it:"""

    code = ErrorCode.invalid_request
    status = 422


@dataclass(eq=False)
class InvalidQuery(KleinkramError):
    """The filter {expression!r} cannot be used: {reason}"""

    code = ErrorCode.invalid_query
    status = 422
    expression: str
    reason: str
    # Where in the text of a query it stands, from 1; None for a filter that is no text.
    column: int | None = None


@dataclass(eq=False)
class InvalidCursor(KleinkramError):
    """The page cursor is not one that this list gave out. Start again from the first page."""

    code = ErrorCode.invalid_cursor
    status = 422


@dataclass(eq=False)
class YamlInvalid(KleinkramError):
    """The YAML cannot be read at line {line}, column {column}: {reason}"""

    code = ErrorCode.yaml_invalid
    status = 422
    line: int
    column: int
    reason: str


@dataclass(eq=False)
class FieldsInvalid(_ProblemsError):
    """The metadata field definitions are not usable:"""

    code = ErrorCode.fields_invalid
    status = 422


@dataclass(eq=False)
class MetadataInvalid(_ProblemsError):
    """The metadata does not satisfy what the project requires:"""

    code = ErrorCode.metadata_invalid
    status = 422


@dataclass(eq=False)
class BodyTooLarge(KleinkramError):
    """The request has {size_bytes} bytes; {limit_bytes} are allowed. Send less at a time."""

    code = ErrorCode.body_too_large
    status = 413
    size_bytes: int
    limit_bytes: int


@dataclass(eq=False)
class FileExists(KleinkramError):
    """{path!r} is already in this mission with other content{hashes}. Nothing was changed; rename yours, or delete the old one first."""  # noqa: E501  one sentence

    code = ErrorCode.file_exists
    status = 409
    path: str
    # Null, as is the id, for who may not read what is there.
    existing_sha256: str | None
    given_sha256: str | None
    existing_file_id: str | None

    @property
    def hashes(self) -> str:
        """Both contents, where both may be told."""
        if self.existing_sha256 is None:
            return ""
        return f" (there sha256 {self.existing_sha256}, yours {self.given_sha256})"

    def sentence(self) -> str:
        """Return the sentence with the hashes."""
        return (type(self).__doc__ or "").format(**self.__dict__, hashes=self.hashes)


@dataclass(eq=False)
class PathConflict(KleinkramError):
    """{path!r} cannot be stored beside {other!r}: one is a file where the other needs a folder, or they differ only in case or Unicode form."""  # noqa: E501  one sentence

    code = ErrorCode.path_conflict
    status = 409
    path: str
    other: str


@dataclass(eq=False)
class NameLeased(KleinkramError):
    """{path!r} is being uploaded by another client right now. Wait for it, or try again after {lease_ends_at}."""

    code = ErrorCode.name_leased
    status = 409
    path: str
    lease_ends_at: str


@dataclass(eq=False)
class UploadGone(KleinkramError):
    """The upload {upload_id} has ended (expired, aborted, or its mission was deleted). Run the same command again to begin anew."""  # noqa: E501  one sentence

    code = ErrorCode.upload_gone
    status = 410
    upload_id: str


@dataclass(eq=False)
class UploadIncomplete(KleinkramError):
    """The store does not hold all of {path!r}: {reason}. Run the same command again; only what is missing is sent."""

    code = ErrorCode.upload_incomplete
    status = 409
    path: str
    reason: str


@dataclass(eq=False)
class ChecksumMismatch(KleinkramError):
    """The bytes that arrived for {path!r} are not the bytes that were read: {reason}. Nothing was kept; upload it again."""  # noqa: E501  one sentence

    code = ErrorCode.checksum_mismatch
    status = 422
    path: str
    reason: str


@dataclass(eq=False)
class FileUnavailable(KleinkramError):
    """The bytes of {path!r} cannot be given out: the store's copy is {state}. Upload the file again to mend it."""

    code = ErrorCode.file_unavailable
    status = 409
    path: str
    state: str


@dataclass(eq=False)
class QuotaExceeded(KleinkramError):
    """The project {project!r} has no room for this: it asks for {asked} {unit}{numbers}. Nothing was begun; delete something, or ask an admin for more."""  # noqa: E501  one sentence

    code = ErrorCode.quota_exceeded
    status = 507
    project: str
    # `bytes` or `files`.
    unit: str
    asked: int
    # Null for whoever may not see what the project holds.
    used: int | None = None
    quota: int | None = None

    @property
    def numbers(self) -> str:
        """What is used of what there is, where that may be told."""
        return "" if self.used is None else f" more, and {self.used} of {self.quota} are used"

    def sentence(self) -> str:
        """Return the sentence with the numbers."""
        return (type(self).__doc__ or "").format(**self.__dict__, numbers=self.numbers)


@dataclass(eq=False)
class MethodNotAllowed(KleinkramError):
    """{method} is not something that {path} answers."""

    code = ErrorCode.method_not_allowed
    status = 405
    method: str
    path: str


@dataclass(eq=False)
class StoreUnavailable(KleinkramError):
    """The object store does not answer ({reason}). Nothing was lost; try again in a moment."""

    code = ErrorCode.store_unavailable
    status = 503
    reason: str


@dataclass(eq=False)
class DatabaseUnavailable(KleinkramError):
    """The database does not answer. Nothing was lost; try again in a moment."""

    code = ErrorCode.database_unavailable
    status = 503


@dataclass(eq=False)
class InternalError(KleinkramError):
    """The server failed in a way it should not. Give the request id {request_id} to whoever runs it."""

    code = ErrorCode.internal_error
    status = 500
    request_id: str


def _all_errors(base: type[KleinkramError]) -> list[type[KleinkramError]]:
    found = []
    for cls in base.__subclasses__():
        found += [cls] if "code" in cls.__dict__ else []
        found += _all_errors(cls)
    return found


ERRORS: dict[ErrorCode, type[KleinkramError]] = {cls.code: cls for cls in _all_errors(KleinkramError)}


class ProblemDocument(BaseModel):
    """A failure on the wire (RFC 9457); the fields of the error's class stand beside these."""

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    code: ErrorCode
    request_id: str | None = None


def to_problem(error: KleinkramError, request_id: str | None) -> ProblemDocument:
    """Return the problem document of an error."""
    extra: dict[str, Any] = error.fields()  # Any: pydantic's extra values are untyped by design
    return ProblemDocument(
        type=f"urn:kleinkram:error:{error.code.value}",
        title=error.code.value.replace("_", " "),
        status=error.status,
        detail=error.sentence(),
        code=error.code,
        request_id=request_id,
        **{key: value for key, value in extra.items() if key != "request_id"},
    )


def from_problem(problem: ProblemDocument) -> KleinkramError:
    """Return the error that a problem document stands for.

    A server newer than this client may leave out or add fields; what is missing makes it an `InternalError`
    carrying the request id rather than a wrong sentence.
    """
    cls = ERRORS[problem.code]
    given = {**(problem.model_extra or {}), "request_id": problem.request_id or "unknown"}
    wanted = {field.name for field in fields(cls)}
    try:
        error: KleinkramError = TypeAdapter(cls).validate_python({k: v for k, v in given.items() if k in wanted})
    except ValidationError:
        return InternalError(request_id=problem.request_id or "unknown")
    return error
