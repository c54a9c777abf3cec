"""Every failure that can cross the wire: one closed set of codes, one class for each.

A class's docstring is its sentence. Its fields fill the braces and travel in the problem document, so that the SDK
raises the same class that the server raised. Never match on a message.

    KleinkramError
      sign-in       NotAuthenticated SignInPending SlowDown SignInDenied SignInExpired SignInFailed SignInRefused
                    SignInTooOld SecondFactorNeeded SecondFactorWrong CodeGone ProviderUnavailable LastSignInMethod
      permissions   Forbidden ScopeMissing TokenTooWide RightExceeded LastOwner LastAdmin GroupFixed
      requests      NotFound WrongClient AmbiguousName NameTaken EditConflict InvalidRequest InvalidQuery InvalidCursor
                    YamlInvalid FieldsInvalid MetadataInvalid BodyTooLarge MethodNotAllowed
      files         FileExists PathConflict NameLeased UploadGone UploadIncomplete ChecksumMismatch FileUnavailable
                    QuotaExceeded
      runs          RunGone NoInputs NoRunner
      server        RateLimited TooManyStreams StoreUnavailable DatabaseUnavailable InternalError

`kleinkram.contract.problems` turns them into problem documents and back.
"""

import enum
from dataclasses import asdict, dataclass
from string import Formatter
from typing import ClassVar

from kleinkram.contract.base import Response


class ErrorCode(str, enum.Enum):
    """The closed set of failures."""

    not_authenticated = "not_authenticated"
    sign_in_pending = "sign_in_pending"
    slow_down = "slow_down"
    sign_in_denied = "sign_in_denied"
    sign_in_expired = "sign_in_expired"
    sign_in_failed = "sign_in_failed"
    sign_in_refused = "sign_in_refused"
    sign_in_too_old = "sign_in_too_old"
    second_factor_needed = "second_factor_needed"
    second_factor_wrong = "second_factor_wrong"
    code_gone = "code_gone"
    provider_unavailable = "provider_unavailable"
    last_sign_in_method = "last_sign_in_method"
    forbidden = "forbidden"
    scope_missing = "scope_missing"
    token_too_wide = "token_too_wide"  # noqa: S105  the code's name
    right_exceeded = "right_exceeded"
    last_owner = "last_owner"
    last_admin = "last_admin"
    group_fixed = "group_fixed"
    not_found = "not_found"
    wrong_client = "wrong_client"
    ambiguous_name = "ambiguous_name"
    name_taken = "name_taken"
    edit_conflict = "edit_conflict"
    invalid_request = "invalid_request"
    invalid_query = "invalid_query"
    invalid_cursor = "invalid_cursor"
    yaml_invalid = "yaml_invalid"
    fields_invalid = "fields_invalid"
    metadata_invalid = "metadata_invalid"
    body_too_large = "body_too_large"
    method_not_allowed = "method_not_allowed"
    file_exists = "file_exists"
    path_conflict = "path_conflict"
    name_leased = "name_leased"
    upload_gone = "upload_gone"
    upload_incomplete = "upload_incomplete"
    checksum_mismatch = "checksum_mismatch"
    file_unavailable = "file_unavailable"
    quota_exceeded = "quota_exceeded"
    run_gone = "run_gone"
    no_inputs = "no_inputs"
    no_runner = "no_runner"
    rate_limited = "rate_limited"
    too_many_streams = "too_many_streams"
    store_unavailable = "store_unavailable"
    database_unavailable = "database_unavailable"
    internal_error = "internal_error"


class FieldProblem(Response):
    """One invalid field of a request, a metadata document or a field definition."""

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
        text = type(self).__doc__ or ""
        names = {name for _, name, _, _ in Formatter().parse(text) if name}
        return text.format(**{name: getattr(self, name) for name in names})

    def fields(self) -> dict[str, object]:
        """Return the typed fields for the problem document."""
        return asdict(self)


# Sign-in


@dataclass(eq=False)
class NotAuthenticated(KleinkramError):
    """You are not signed in: {reason}. Sign in with `klein login {server}`; a robot needs a valid token."""

    code = ErrorCode.not_authenticated
    status = 401
    reason: str
    # The address by which the client reaches the server; the client fills it in.
    server: str = "URL"


@dataclass(eq=False)
class SignInPending(KleinkramError):
    """The code has not been entered yet. Enter it on the page, or ask again in {interval_s:g} s."""

    code = ErrorCode.sign_in_pending
    status = 400
    interval_s: float


@dataclass(eq=False)
class SlowDown(KleinkramError):
    """Too many requests. Wait at least {interval_s:g} s before the next one."""

    code = ErrorCode.slow_down
    status = 429
    interval_s: float


@dataclass(eq=False)
class SignInDenied(KleinkramError):
    """The sign-in was denied on the page. Nothing was saved; run `klein login` to start again."""

    code = ErrorCode.sign_in_denied
    status = 403


@dataclass(eq=False)
class SignInExpired(KleinkramError):
    """The sign-in was not finished in time, or its code has been used. Run `klein login` to start again."""

    code = ErrorCode.sign_in_expired
    status = 410


@dataclass(eq=False)
class SignInFailed(KleinkramError):
    """The e-mail address or the password is wrong. Try again, or ask an admin for a link that resets the password."""

    code = ErrorCode.sign_in_failed
    status = 401


@dataclass(eq=False)
class SignInRefused(KleinkramError):
    """You are not signed in: {reason}"""

    code = ErrorCode.sign_in_refused
    status = 403
    reason: str


@dataclass(eq=False)
class SignInTooOld(KleinkramError):
    """To {operation}, sign in again: you last did so more than {minutes:g} minutes ago, or this token does not record when. In a browser, the page asks for it; in a terminal, run `klein login` and repeat the command."""  # noqa: E501  one sentence

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
    """The code is wrong, was used before, or is too old. Wait for the next one; after {max_attempts} wrong codes no code is accepted for {minutes:g} minutes. An admin can switch off the second factor for you."""  # noqa: E501  one sentence

    code = ErrorCode.second_factor_wrong
    status = 401
    max_attempts: int
    minutes: float


@dataclass(eq=False)
class CodeGone(KleinkramError):
    """This link or code is not valid (any more): it was used, it expired, or a newer one replaced it. Ask for a new one."""  # noqa: E501  one sentence

    code = ErrorCode.code_gone
    status = 410


@dataclass(eq=False)
class ProviderUnavailable(KleinkramError):
    """The sign-in with {provider} failed: {reason}. Nothing was changed; try again, or sign in another way."""

    code = ErrorCode.provider_unavailable
    status = 503
    provider: str
    reason: str


@dataclass(eq=False)
class LastSignInMethod(KleinkramError):
    """{provider} stays linked, because it is your last way to sign in. Link another provider first, or ask an admin for a link that sets a password."""  # noqa: E501  one sentence

    code = ErrorCode.last_sign_in_method
    status = 409
    provider: str


# Permissions


@dataclass(eq=False)
class Forbidden(KleinkramError):
    """You may not {operation}: this requires {requirement}"""

    code = ErrorCode.forbidden
    status = 403
    noun: str
    operation: str
    needs: str

    @property
    def requirement(self) -> str:
        """What is needed, where, and whom to ask."""
        if self.noun in {"project", "mission"}:
            return f"{self.needs} on the {self.noun}. Ask one of its owners."
        return f"{self.needs}."


@dataclass(eq=False)
class ScopeMissing(KleinkramError):
    """To {operation}, you need {needs}. Use another token, or sign in."""

    code = ErrorCode.scope_missing
    status = 403
    operation: str
    needs: str


@dataclass(eq=False)
class TokenTooWide(KleinkramError):
    """A token cannot create one that may do more than itself: {reason}. Sign in to create that one."""

    code = ErrorCode.token_too_wide
    status = 403
    reason: str


@dataclass(eq=False)
class RightExceeded(KleinkramError):
    """You may not grant {requested} on this {noun}: you have {own}. Nobody can grant more, or for longer, than they have."""  # noqa: E501  one sentence

    code = ErrorCode.right_exceeded
    status = 403
    noun: str
    requested: str
    own: str


@dataclass(eq=False)
class LastOwner(KleinkramError):
    """This would leave {listing} without a permanent owner: an active person with DELETE that does not expire and is not granted by e-mail address. Grant it to somebody else first."""  # noqa: E501  one sentence

    code = ErrorCode.last_owner
    status = 409
    projects: list[str]

    @property
    def listing(self) -> str:
        """The projects, quoted."""
        return ", ".join(repr(name) for name in self.projects)


@dataclass(eq=False)
class LastAdmin(KleinkramError):
    """This would leave the server without a permanent admin: an active person whose admin rights do not expire. Make somebody else an admin first."""  # noqa: E501  one sentence

    code = ErrorCode.last_admin
    status = 409


@dataclass(eq=False)
class GroupFixed(KleinkramError):
    """The group {name!r} does not allow this change: {reason}."""

    code = ErrorCode.group_fixed
    status = 409
    name: str
    reason: str


# Requests


@dataclass(eq=False)
class NotFound(KleinkramError):
    """There is no {noun} {ref!r} that you may see."""

    code = ErrorCode.not_found
    status = 404
    noun: str
    ref: str


@dataclass(eq=False)
class WrongClient(KleinkramError):
    """This server does not support the Python package `kleinkram`. Install its own client with `pip install open-kleinkram`, in an environment without the other, then sign in with `klein login {server}`."""  # noqa: E501  one sentence

    code = ErrorCode.wrong_client
    status = 404  # the original's client shows the `message` of a 404
    server: str
    message: str = ""

    def __post_init__(self) -> None:
        """Copy the sentence to the field that the original's client reads."""
        super().__post_init__()
        self.message = self.sentence()


@dataclass(eq=False)
class AmbiguousName(KleinkramError):
    """{ref!r} names more than one {noun}: {listing}. Use its id, or name what contains it."""

    code = ErrorCode.ambiguous_name
    status = 409
    noun: str
    ref: str
    candidates: list[str]

    @property
    def listing(self) -> str:
        """The candidates in one line."""
        return "; ".join(self.candidates)


@dataclass(eq=False)
class NameTaken(KleinkramError):
    """There already is a {noun} named {name!r} here (names that differ only in case or Unicode form are the same)."""

    code = ErrorCode.name_taken
    status = 409
    noun: str
    name: str


@dataclass(eq=False)
class EditConflict(KleinkramError):
    """The {noun} {name!r} was changed by somebody else after you read it. Your change was not saved; read it again, then repeat your change."""  # noqa: E501  one sentence

    code = ErrorCode.edit_conflict
    status = 412
    noun: str
    name: str
    etag: str


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
    """The request is invalid:"""

    code = ErrorCode.invalid_request
    status = 422


@dataclass(eq=False)
class InvalidQuery(KleinkramError):
    """The filter {expression!r} is invalid: {reason}"""

    code = ErrorCode.invalid_query
    status = 422
    expression: str
    reason: str
    # Its place in the text of a query, from 1; None for a filter that is not text.
    column: int | None = None


@dataclass(eq=False)
class InvalidCursor(KleinkramError):
    """The page cursor does not belong to this list. Start again from the first page."""

    code = ErrorCode.invalid_cursor
    status = 422


@dataclass(eq=False)
class YamlInvalid(KleinkramError):
    """The YAML is invalid at line {line}, column {column}: {reason}"""

    code = ErrorCode.yaml_invalid
    status = 422
    line: int
    column: int
    reason: str


@dataclass(eq=False)
class FieldsInvalid(_ProblemsError):
    """The metadata field definitions are invalid:"""

    code = ErrorCode.fields_invalid
    status = 422


@dataclass(eq=False)
class MetadataInvalid(_ProblemsError):
    """The metadata does not match the fields of the project:"""

    code = ErrorCode.metadata_invalid
    status = 422


@dataclass(eq=False)
class BodyTooLarge(KleinkramError):
    """The request has {size_bytes} bytes; at most {limit_bytes} are allowed. Send less at a time."""

    code = ErrorCode.body_too_large
    status = 413
    size_bytes: int
    limit_bytes: int


@dataclass(eq=False)
class MethodNotAllowed(KleinkramError):
    """{path} does not support {method}."""

    code = ErrorCode.method_not_allowed
    status = 405
    method: str
    path: str


# Files


@dataclass(eq=False)
class FileExists(KleinkramError):
    """{path!r} is already in this mission with other content{hashes}. Nothing was changed; rename your file, or delete the old one first."""  # noqa: E501  one sentence

    code = ErrorCode.file_exists
    status = 409
    path: str
    # Null, like the id, for a caller who may not read the existing file.
    existing_sha256: str | None
    sent_sha256: str | None
    existing_file_id: str | None

    @property
    def hashes(self) -> str:
        """Both checksums, where the caller may see them."""
        if self.existing_sha256 is None:
            return ""
        return f" (existing sha256 {self.existing_sha256}, yours {self.sent_sha256})"


@dataclass(eq=False)
class PathConflict(KleinkramError):
    """{path!r} conflicts with {other!r}: one is a file where the other needs a folder, or they differ only in case or Unicode form."""  # noqa: E501  one sentence

    code = ErrorCode.path_conflict
    status = 409
    path: str
    other: str


@dataclass(eq=False)
class NameLeased(KleinkramError):
    """Another client is uploading {path!r} right now. Wait for it, or try again after {lease_ends_at}."""

    code = ErrorCode.name_leased
    status = 409
    path: str
    lease_ends_at: str


@dataclass(eq=False)
class UploadGone(KleinkramError):
    """The upload {upload_id} has ended (it expired, was aborted, or its mission was deleted). Run the same command again to start a new one."""  # noqa: E501  one sentence

    code = ErrorCode.upload_gone
    status = 410
    upload_id: str


@dataclass(eq=False)
class UploadIncomplete(KleinkramError):
    """The object store does not have all of {path!r}: {reason}. Run the same command again; it sends only what is missing."""  # noqa: E501  one sentence

    code = ErrorCode.upload_incomplete
    status = 409
    path: str
    reason: str


@dataclass(eq=False)
class ChecksumMismatch(KleinkramError):
    """The bytes that arrived for {path!r} are not the bytes that were read: {reason}. Nothing was saved; upload it again."""  # noqa: E501  one sentence

    code = ErrorCode.checksum_mismatch
    status = 422
    path: str
    reason: str


@dataclass(eq=False)
class FileUnavailable(KleinkramError):
    """The content of {path!r} is not available: the stored copy is {state}. Upload the file again to repair it."""

    code = ErrorCode.file_unavailable
    status = 409
    path: str
    state: str


@dataclass(eq=False)
class QuotaExceeded(KleinkramError):
    """The quota of project {project!r} does not allow {requested} {unit}{numbers}. Nothing was started; delete something, or ask an admin for more."""  # noqa: E501  one sentence

    code = ErrorCode.quota_exceeded
    status = 507
    project: str
    # `bytes` or `files`.
    unit: str
    requested: int
    # Null for a caller who may not see the amounts of the project.
    used: int | None = None
    quota: int | None = None

    @property
    def numbers(self) -> str:
        """What is used of the quota, where the caller may see it."""
        return "" if self.used is None else f" more: {self.used} of {self.quota} are used"


# Runs


@dataclass(eq=False)
class RunGone(KleinkramError):
    """The run {run_id} does not belong to this runner (any more): it was given to another runner, cancelled, deleted, or has ended. Stop all work on it."""  # noqa: E501  one sentence

    code = ErrorCode.run_gone
    status = 409
    run_id: str


@dataclass(eq=False)
class NoInputs(KleinkramError):
    """No file of the mission {mission!r} is an input of {action}, which reads {inputs}. Upload such a file, or choose another mission or action."""  # noqa: E501  one sentence

    code = ErrorCode.no_inputs
    status = 409
    mission: str
    action: str
    inputs: str


@dataclass(eq=False)
class NoRunner(KleinkramError):
    """The action {action} was not started, because no runner would ever take it. {reason}"""

    code = ErrorCode.no_runner
    status = 409
    action: str
    reason: str


# Server


@dataclass(eq=False)
class RateLimited(KleinkramError):
    """Too many requests: at most {limit} {what} in {window_s} s are allowed. Try again in {retry_after_s} s."""

    code = ErrorCode.rate_limited
    status = 429
    what: str
    limit: int
    window_s: int
    retry_after_s: int


@dataclass(eq=False)
class TooManyStreams(KleinkramError):
    """Your account has {limit} streams or waiting requests open, which is the limit. Close a page or a program."""

    code = ErrorCode.too_many_streams
    status = 429
    limit: int


@dataclass(eq=False)
class StoreUnavailable(KleinkramError):
    """The object store is not available ({reason}). Nothing was lost; try again in a moment."""

    code = ErrorCode.store_unavailable
    status = 503
    reason: str


@dataclass(eq=False)
class DatabaseUnavailable(KleinkramError):
    """The database is not available ({reason}). Nothing was lost; try again in a moment."""

    code = ErrorCode.database_unavailable
    status = 503
    reason: str = "it does not answer"


@dataclass(eq=False)
class InternalError(KleinkramError):
    """The server failed unexpectedly. Report the request id {request_id} to its administrator."""

    code = ErrorCode.internal_error
    status = 500
    request_id: str


ERRORS: dict[ErrorCode, type[KleinkramError]] = {
    cls.code: cls
    for cls in list(vars().values())
    if isinstance(cls, type) and issubclass(cls, KleinkramError) and hasattr(cls, "code")
}
