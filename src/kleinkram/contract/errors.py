"""Every error of the API: a closed set of codes, with one class for each.

A class's docstring is its sentence. Its fields fill the braces and travel in the problem document, so that the SDK
raises the same class that the server raised. Never match on a message.

    KleinkramError
      sign-in       NotAuthenticated SignInPending SlowDown SignInDenied SignInExpired SignInFailed SignInRefused
                    SignInTooOld SecondFactorNeeded SecondFactorWrong CodeGone ProviderUnavailable LastSignInMethod
      permissions   Forbidden ScopeMissing TokenTooWide RightExceeded LastOwner LastAdmin GroupFixed PersonErased
      requests      NotFound WrongClient AmbiguousName NameTaken NotFromLibrary EditConflict InvalidRequest
                    InvalidQuery InvalidCursor YamlInvalid FieldsInvalid MetadataInvalid BodyTooLarge MethodNotAllowed
      files         FileExists PathConflict NameLeased UploadGone UploadIncomplete ChecksumMismatch FileUnavailable
                    CannotSlice QuotaExceeded
      runs          RunGone NoInputs NoRunner
      server        RateLimited TooManyStreams TooManySlices StoreUnavailable DatabaseUnavailable InternalError

`kleinkram.contract.problems` turns them into problem documents and back.
"""

import enum
import re
from dataclasses import asdict, dataclass
from string import Formatter
from typing import ClassVar

from typing_extensions import dataclass_transform

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
    person_erased = "person_erased"
    not_found = "not_found"
    wrong_client = "wrong_client"
    ambiguous_name = "ambiguous_name"
    name_taken = "name_taken"
    not_from_library = "not_from_library"
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
    cannot_slice = "cannot_slice"
    quota_exceeded = "quota_exceeded"
    run_gone = "run_gone"
    no_inputs = "no_inputs"
    no_runner = "no_runner"
    rate_limited = "rate_limited"
    too_many_streams = "too_many_streams"
    too_many_slices = "too_many_slices"
    store_unavailable = "store_unavailable"
    database_unavailable = "database_unavailable"
    internal_error = "internal_error"


ERRORS: dict[ErrorCode, type["KleinkramError"]] = {}
"""The class of each code."""


class FieldProblem(Response):
    """One invalid field of a request, a metadata document or a field definition."""

    field: str
    message: str
    line: int | None = None
    column: int | None = None


@dataclass_transform(eq_default=False)
@dataclass(eq=False)
class KleinkramError(Exception):
    """Something went wrong."""

    code: ClassVar[ErrorCode]
    status: ClassVar[int]

    def __init_subclass__(cls, *, status: int | None = None) -> None:
        """Make a subclass a dataclass; with a status, also the error of the code that is its name in snake case."""
        super().__init_subclass__()
        dataclass(eq=False)(cls)
        if status is not None:
            cls.status = status
            cls.code = ErrorCode(re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower())
            ERRORS[cls.code] = cls

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


class NotAuthenticated(KleinkramError, status=401):
    """You are not signed in: {reason}. Sign in with `klein login {server}`; a robot needs a valid token."""

    reason: str
    # The address by which the client reaches the server; the client fills it in.
    server: str = "URL"


class SignInPending(KleinkramError, status=400):
    """The code has not been entered yet. Enter it on the page, or ask again in {interval_s:g} s."""

    interval_s: float


class SlowDown(KleinkramError, status=429):
    """Too many requests. Wait at least {interval_s:g} s before the next one."""

    interval_s: float


class SignInDenied(KleinkramError, status=403):
    """The sign-in was denied on the page. Nothing was saved; run `klein login` to start again."""


class SignInExpired(KleinkramError, status=410):
    """The sign-in was not finished in time, or its code has been used. Run `klein login` to start again."""


class SignInFailed(KleinkramError, status=401):
    """The e-mail address or the password is wrong. Try again, or ask an admin for a link that resets the password."""


class SignInRefused(KleinkramError, status=403):
    """You are not signed in: {reason}"""

    reason: str


class SignInTooOld(KleinkramError, status=403):
    """To {operation}, sign in again: you last did so more than {minutes:g} minutes ago, or this token does not record when. In a browser, the page asks for it; in a terminal, run `klein login` and repeat the command."""  # noqa: E501  one sentence

    operation: str
    minutes: float


class SecondFactorNeeded(KleinkramError, status=401):
    """This account also needs a code from its authenticator app, or one of its recovery codes."""


class SecondFactorWrong(KleinkramError, status=401):
    """The code is wrong, was used before, or is too old. Wait for the next one; after {max_attempts} wrong codes no code is accepted for {minutes:g} minutes. An admin can switch off the second factor for you."""  # noqa: E501  one sentence

    max_attempts: int
    minutes: float


class CodeGone(KleinkramError, status=410):
    """This link or code is not valid: it was already used, has expired, or was replaced by a newer one. Ask for a new one."""  # noqa: E501  one sentence


class ProviderUnavailable(KleinkramError, status=503):
    """The sign-in with {provider} failed: {reason}. Nothing was changed; try again, or sign in another way."""

    provider: str
    reason: str


class LastSignInMethod(KleinkramError, status=409):
    """{provider} stays linked, because it is your last way to sign in. Link another provider first, or ask an admin for a link that sets a password."""  # noqa: E501  one sentence

    provider: str


# Permissions


class Forbidden(KleinkramError, status=403):
    """You may not {operation}: this requires {requirement}"""

    resource_type: str
    operation: str
    needs: str

    @property
    def requirement(self) -> str:
        """The missing right, its object, and the people who can grant it."""
        if self.resource_type in {"project", "mission"}:
            return f"{self.needs} on the {self.resource_type}. Ask one of its owners."
        return f"{self.needs}."


class ScopeMissing(KleinkramError, status=403):
    """To {operation}, you need {needs}. Use another token, or sign in."""

    operation: str
    needs: str


class TokenTooWide(KleinkramError, status=403):
    """A token cannot create one that may do more than itself: {reason}. Sign in to create that one."""

    reason: str


class RightExceeded(KleinkramError, status=403):
    """You may not grant {requested} on this {resource_type}: you have {own}. Nobody can grant more, or for longer, than they have."""  # noqa: E501  one sentence

    resource_type: str
    requested: str
    own: str


class LastOwner(KleinkramError, status=409):
    """This would leave {listing} without a permanent owner: an active person with DELETE that does not expire and is not granted by e-mail address. Grant it to somebody else first."""  # noqa: E501  one sentence

    projects: list[str]

    @property
    def listing(self) -> str:
        """The projects, quoted."""
        return ", ".join(repr(name) for name in self.projects)


class LastAdmin(KleinkramError, status=409):
    """This would leave the server without a permanent admin: an active person whose admin rights do not expire. Make somebody else an admin first."""  # noqa: E501  one sentence


class GroupFixed(KleinkramError, status=409):
    """The group {name!r} does not allow this change: {reason}."""

    name: str
    reason: str


class PersonErased(KleinkramError, status=409):
    """{name} was erased, which cannot be undone. If they sign in again, they get a new account."""

    name: str


# Requests


class NotFound(KleinkramError, status=404):
    """There is no {resource_type} {ref!r} that you may see."""

    resource_type: str
    ref: str


class WrongClient(KleinkramError, status=404):  # the client of the original shows the `message` of a 404
    """This server does not support the Python package `kleinkram`. Install its own client with `pip install open-kleinkram`, in an environment without the other, then sign in with `klein login {server}`."""  # noqa: E501  one sentence

    server: str
    message: str = ""

    def __post_init__(self) -> None:
        """Copy the sentence to the field that the original's client reads."""
        super().__post_init__()
        self.message = self.sentence()


class AmbiguousName(KleinkramError, status=409):
    """{ref!r} names more than one {resource_type}: {listing}. Use its id, or name what contains it."""

    resource_type: str
    ref: str
    candidates: list[str]

    @property
    def listing(self) -> str:
        """The candidates in one line."""
        return "; ".join(self.candidates)


class NameTaken(KleinkramError, status=409):
    """There is already a {resource_type} named {name!r} here (names that differ only in case or Unicode form are the same)."""  # noqa: E501  one sentence

    resource_type: str
    name: str


class NotFromLibrary(KleinkramError, status=409):
    """The action {name!r} here was published by somebody, not added from the library, so it was not replaced. Archive it to add the one from the library."""  # noqa: E501  one sentence

    name: str


class EditConflict(KleinkramError, status=412):
    """The {resource_type} {name!r} was changed by somebody else after you read it. Your change was not saved; read it again, then repeat your change."""  # noqa: E501  one sentence

    resource_type: str
    name: str
    etag: str


class _ProblemsError(KleinkramError):
    problems: list[FieldProblem]

    def fields(self) -> dict[str, object]:
        return {"problems": [problem.model_dump(exclude_none=True) for problem in self.problems]}

    def sentence(self) -> str:
        listing = "; ".join(f"{problem.field}: {problem.message}" for problem in self.problems)
        return f"{type(self).__doc__} {listing}"


class InvalidRequest(_ProblemsError, status=422):
    """The request is invalid:"""


class InvalidQuery(KleinkramError, status=422):
    """The filter {expression!r} is invalid: {reason}"""

    expression: str
    reason: str
    # The position in the text of a query, from 1; None for a filter that is not text.
    column: int | None = None


class InvalidCursor(KleinkramError, status=422):
    """The page cursor does not belong to this list. Start again from the first page."""


class YamlInvalid(KleinkramError, status=422):
    """The YAML is invalid at line {line}, column {column}: {reason}"""

    line: int
    column: int
    reason: str


class FieldsInvalid(_ProblemsError, status=422):
    """The metadata field definitions are invalid:"""


class MetadataInvalid(_ProblemsError, status=422):
    """The metadata does not match the fields of the project:"""


class BodyTooLarge(KleinkramError, status=413):
    """The request has {size_bytes} bytes; at most {limit_bytes} are allowed. Send less at a time."""

    size_bytes: int
    limit_bytes: int


class MethodNotAllowed(KleinkramError, status=405):
    """{path} does not support {method}."""

    method: str
    path: str


# Files


class FileExists(KleinkramError, status=409):
    """{path!r} is already in this mission with other content{hashes}. Nothing was changed; rename your file, or delete the old one first."""  # noqa: E501  one sentence

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


class PathConflict(KleinkramError, status=409):
    """{path!r} conflicts with {other!r}: one is a file where the other needs a folder, or they differ only in case or Unicode form."""  # noqa: E501  one sentence

    path: str
    other: str


class NameLeased(KleinkramError, status=409):
    """Another client is uploading {path!r} right now. Wait for it, or try again after {lease_ends_at}."""

    path: str
    lease_ends_at: str


class UploadGone(KleinkramError, status=410):
    """The upload {upload_id} has ended (it expired, was aborted, or its mission was deleted). Run the same command again to start a new one."""  # noqa: E501  one sentence

    upload_id: str


class UploadIncomplete(KleinkramError, status=409):
    """The object store does not have all of {path!r}: {reason}. Run the same command again; it sends only what is missing."""  # noqa: E501  one sentence

    path: str
    reason: str


class ChecksumMismatch(KleinkramError, status=422):
    """The received bytes of {path!r} differ from those that were read: {reason}. Nothing was saved; upload it again."""

    path: str
    reason: str


class FileUnavailable(KleinkramError, status=409):
    """The content of {path!r} is not available: the stored copy is {state}. Upload the file again to repair it."""

    path: str
    state: str


class CannotSlice(KleinkramError, status=409):
    """The server cannot make a slice of {path!r}: {reason}. On your computer, `klein cut` may be able to."""

    path: str
    reason: str


class QuotaExceeded(KleinkramError, status=507):
    """The quota of project {project!r} does not allow {requested} {unit}{numbers}. Nothing was started; delete something, or ask an admin for more."""  # noqa: E501  one sentence

    project: str
    # `bytes` or `files`.
    unit: str
    requested: int
    # Null for a caller who may not see the amounts of the project.
    used: int | None = None
    quota: int | None = None

    @property
    def numbers(self) -> str:
        """Used part of the quota, if the caller may see it."""
        return "" if self.used is None else f" more: {self.used} of {self.quota} are used"


# Runs


class RunGone(KleinkramError, status=409):
    """The run {run_id} is not assigned to this runner: it was assigned to another runner, cancelled or deleted, or has ended. Stop all work on it."""  # noqa: E501  one sentence

    run_id: str


class NoInputs(KleinkramError, status=409):
    """No file of the mission {mission!r} is an input of {action}, which reads {inputs}. Upload such a file, or choose another mission or action."""  # noqa: E501  one sentence

    mission: str
    action: str
    inputs: str


class NoRunner(KleinkramError, status=409):
    """The action {action} was not started, because no runner would ever take it. {reason}"""

    action: str
    reason: str


# Server


class RateLimited(KleinkramError, status=429):
    """Too many requests: at most {limit} {what} in {window_s} s are allowed. Try again in {retry_after_s} s."""

    what: str
    limit: int
    window_s: int
    retry_after_s: int


class TooManyStreams(KleinkramError, status=429):
    """Your account has {limit} streams or waiting requests open, which is the limit. Close a page or a program."""

    limit: int


class TooManySlices(KleinkramError, status=429):
    """At most {limit} slices are made at once {scope}. Wait until one is done, or use `klein cut`."""

    limit: int
    # `for one account` or `by this server`.
    scope: str


class StoreUnavailable(KleinkramError, status=503):
    """The object store is not available ({reason}). Nothing was lost; try again in a moment."""

    reason: str


class DatabaseUnavailable(KleinkramError, status=503):
    """The database is not available ({reason}). Nothing was lost; try again in a moment."""

    reason: str = "it does not answer"


class InternalError(KleinkramError, status=500):
    """The server failed unexpectedly. Report the request id {request_id} to its administrator."""

    request_id: str
