"""What every failure is, and the closed set of their codes."""

import enum
from dataclasses import asdict, dataclass
from string import Formatter
from typing import ClassVar

from kleinkram.contract.wire import Response


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
    rate_limited = "rate_limited"
    too_many_streams = "too_many_streams"
    forbidden = "forbidden"
    scope_missing = "scope_missing"
    token_too_wide = "token_too_wide"  # noqa: S105  the code's name
    right_exceeded = "right_exceeded"
    last_owner = "last_owner"
    last_admin = "last_admin"
    last_way_in = "last_way_in"
    group_fixed = "group_fixed"
    wrong_client = "wrong_client"
    not_found = "not_found"
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
    method_not_allowed = "method_not_allowed"
    store_unavailable = "store_unavailable"
    database_unavailable = "database_unavailable"
    internal_error = "internal_error"


class FieldProblem(Response):
    """One thing wrong with one field of a request, a metadata document or a field definition."""

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
        named = {name for _, name, _, _ in Formatter().parse(text) if name}
        return text.format(**{name: getattr(self, name) for name in named})

    def fields(self) -> dict[str, object]:
        """Return the typed fields as they travel."""
        return asdict(self)
