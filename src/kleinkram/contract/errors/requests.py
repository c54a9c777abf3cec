"""What was asked for is not there, or was asked in a way that cannot be answered."""

from dataclasses import dataclass

from kleinkram.contract.errors.base import ErrorCode, FieldProblem, KleinkramError


@dataclass(eq=False)
class NotFound(KleinkramError):
    """There is no {noun} {ref!r} that you may see."""

    code = ErrorCode.not_found
    status = 404
    noun: str
    ref: str


@dataclass(eq=False)
class WrongClient(KleinkramError):
    """This server is not spoken to by the Python package `kleinkram`: install its own client with `pip install open-kleinkram`, in an environment without the other, then sign in with `klein login {server}`."""  # noqa: E501  one sentence

    code = ErrorCode.wrong_client
    status = 404  # the original's client shows the `message` of a 404
    server: str
    message: str = ""

    def __post_init__(self) -> None:
        """Give the sentence the name under which the original's client looks for it."""
        super().__post_init__()
        self.message = self.sentence()


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


@dataclass(eq=False)
class NameTaken(KleinkramError):
    """There already is a {noun} named {name!r} here (names that differ only in case or Unicode form are the same)."""

    code = ErrorCode.name_taken
    status = 409
    noun: str
    name: str


@dataclass(eq=False)
class EditConflict(KleinkramError):
    """The {noun} {name!r} was changed by somebody else since you looked at it, so nothing of yours was kept. Look at it as it is now, then make your change again."""  # noqa: E501  one sentence

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
class MethodNotAllowed(KleinkramError):
    """{method} is not something that {path} answers."""

    code = ErrorCode.method_not_allowed
    status = 405
    method: str
    path: str
