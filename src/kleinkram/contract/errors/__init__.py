"""Every failure that can cross the wire: one closed set of codes, one class each.

A class's docstring is its sentence; its fields fill the braces and travel in the problem document (RFC 9457), so the
SDK raises the very class that the server raised. Nobody matches on a message.
"""

from kleinkram.contract.errors.base import ErrorCode, FieldProblem, KleinkramError
from kleinkram.contract.errors.files import (
    ChecksumMismatch,
    FileExists,
    FileUnavailable,
    NameLeased,
    PathConflict,
    QuotaExceeded,
    UploadGone,
    UploadIncomplete,
)
from kleinkram.contract.errors.requests import (
    AmbiguousName,
    BodyTooLarge,
    FieldsInvalid,
    InvalidCursor,
    InvalidQuery,
    InvalidRequest,
    MetadataInvalid,
    MethodNotAllowed,
    NameTaken,
    NotFound,
    YamlInvalid,
)
from kleinkram.contract.errors.rights import (
    Forbidden,
    GroupFixed,
    LastAdmin,
    LastOwner,
    RightExceeded,
    ScopeMissing,
    TokenTooWide,
)
from kleinkram.contract.errors.runs import NoInputs, RunGone
from kleinkram.contract.errors.server import (
    DatabaseUnavailable,
    InternalError,
    RateLimited,
    StoreUnavailable,
    TooManyStreams,
)
from kleinkram.contract.errors.signing_in import (
    CodeGone,
    LastWayIn,
    NotAuthenticated,
    ProviderUnavailable,
    SignInDenied,
    SignInExpired,
    SignInFailed,
    SignInPending,
    SignInRefused,
    SlowDown,
)
from kleinkram.contract.errors.wire import ERRORS, ProblemDocument, from_problem, to_problem

__all__ = [
    "ERRORS",
    "AmbiguousName",
    "BodyTooLarge",
    "ChecksumMismatch",
    "CodeGone",
    "DatabaseUnavailable",
    "ErrorCode",
    "FieldProblem",
    "FieldsInvalid",
    "FileExists",
    "FileUnavailable",
    "Forbidden",
    "GroupFixed",
    "InternalError",
    "InvalidCursor",
    "InvalidQuery",
    "InvalidRequest",
    "KleinkramError",
    "LastAdmin",
    "LastOwner",
    "LastWayIn",
    "MetadataInvalid",
    "MethodNotAllowed",
    "NameLeased",
    "NameTaken",
    "NoInputs",
    "NotAuthenticated",
    "NotFound",
    "PathConflict",
    "ProblemDocument",
    "ProviderUnavailable",
    "QuotaExceeded",
    "RateLimited",
    "RightExceeded",
    "RunGone",
    "ScopeMissing",
    "SignInDenied",
    "SignInExpired",
    "SignInFailed",
    "SignInPending",
    "SignInRefused",
    "SlowDown",
    "StoreUnavailable",
    "TokenTooWide",
    "TooManyStreams",
    "UploadGone",
    "UploadIncomplete",
    "YamlInvalid",
    "from_problem",
    "to_problem",
]
