"""Actions: versioned definitions of what to run on the data of a mission.

The same document is used in `action.yaml`, in the `[tool.kleinkram]` table of a script, and on the wire.
"""

import datetime
import enum
import math
import uuid
from collections.abc import Mapping
from fractions import Fraction
from typing import Annotated, Any

from pydantic import AfterValidator, AliasChoices, BeforeValidator, ConfigDict, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.access import Right
from kleinkram.contract.base import ETag, Request, Response, etag_of
from kleinkram.contract.metadata import MAX_KEY_CHARACTERS
from kleinkram.contract.names import Label, Name, Term, check_text
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.reports import Code
from kleinkram.contract.units import read_duration, read_size

MAX_SCRIPT_CHARACTERS = 500_000
MAX_LOCK_CHARACTERS = 1_000_000
MAX_PARAMETERS = 100
MAX_DECLARED_METRICS = 100
MAX_VALUE_CHARACTERS = 10_000

ParameterName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
ParameterValue = bool | int | float | str
ParameterValues = dict[str, ParameterValue]
Argument = Annotated[str, AfterValidator(check_text), Field(max_length=100_000)]
Globs = Annotated[list[Term], Field(max_length=50)]
MetadataKey = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=MAX_KEY_CHARACTERS)]
ImageName = Annotated[str, Field(pattern=r"^[a-z0-9][A-Za-z0-9._/:@-]{0,299}$")]
LibraryVersion = Annotated[str, Field(pattern=r"^kleinkram/[a-z0-9-]{1,64}@[0-9A-Za-z.+!-]{1,64}$")]
"""A shipped action, and the version of Kleinkram that it was added from: `kleinkram/preview@1.2.0`."""


class ParameterType(str, enum.Enum):
    """Type of a parameter. A `topic` is a string for which forms offer the topics of the mission."""

    string = "string"
    integer = "integer"
    number = "number"
    boolean = "boolean"
    choice = "choice"
    topic = "topic"


class Parameter(Request):
    """A parameter of an action; required where it has no default. `minimum` and `maximum` are inclusive."""

    name: ParameterName
    type: ParameterType
    description: Annotated[str, Field(max_length=1000)] = ""
    unit: Annotated[str, Field(max_length=32)] | None = None
    default: ParameterValue | None = None
    choices: Annotated[list[Label], Field(min_length=1, max_length=200)] | None = None
    minimum: float | None = None
    maximum: float | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        is_number = self.type in {ParameterType.integer, ParameterType.number}
        if not is_number and (self.minimum, self.maximum, self.unit) != (None, None, None):
            raise ValueError("minimum, maximum and unit are only for integers and numbers")
        if (self.type is ParameterType.choice) != (self.choices is not None):
            raise ValueError("'choices' are required for a choice, and only for a choice")
        if self.default is not None:
            self.check(self.default)
        return self

    def check(self, value: ParameterValue) -> ParameterValue:
        """Return a value, converted to the type of this parameter. Raises ValueError."""
        type_name, accepted = _PYTHON_TYPES[self.type]
        if not isinstance(value, accepted) or (isinstance(value, bool) and self.type is not ParameterType.boolean):
            raise ValueError(f"{self.name!r} is {type_name}, not {value!r}")
        if isinstance(value, str) and len(check_text(value)) > MAX_VALUE_CHARACTERS:
            raise ValueError(f"{self.name!r} has {len(value)} characters; {MAX_VALUE_CHARACTERS} are allowed")
        if self.choices is not None and value not in self.choices:
            raise ValueError(f"{self.name!r} is one of {', '.join(self.choices)}, not {value!r}")
        if self.type is ParameterType.number:
            value = float(value)
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{self.name!r} is a finite number, not {value}")
        if self.minimum is not None and not isinstance(value, str) and value < self.minimum:
            raise ValueError(f"{self.name!r} is at least {self.minimum:g}, not {value}")
        if self.maximum is not None and not isinstance(value, str) and value > self.maximum:
            raise ValueError(f"{self.name!r} is at most {self.maximum:g}, not {value}")
        return value

    def read(self, text: str) -> ParameterValue:
        """Parse a value, as on a command line. Raises ValueError."""
        type_name, _ = _PYTHON_TYPES[self.type]
        value: ParameterValue = text
        try:
            if self.type is ParameterType.boolean:
                value = {"true": True, "false": False}[text.lower()]
            elif self.type is ParameterType.integer:
                value = int(text)
            elif self.type is ParameterType.number:
                value = float(text)
        except (KeyError, ValueError):
            raise ValueError(f"{self.name!r} is {type_name}, not {text!r}") from None
        return self.check(value)


_PYTHON_TYPES: dict[ParameterType, tuple[str, tuple[type, ...]]] = {
    ParameterType.string: ("a text", (str,)),
    ParameterType.topic: ("the name of a topic", (str,)),
    ParameterType.choice: ("a text", (str,)),
    ParameterType.integer: ("a whole number", (int,)),
    ParameterType.number: ("a number", (int, float)),
    ParameterType.boolean: ("true or false", (bool,)),
}


class Network(str, enum.Enum):
    """Network access of a run: none, the API and the store with its own token, or that of its machine."""

    none = "none"
    api = "api"
    open = "open"


class Inputs(Request):
    """The input files of an action: those that match all three lists of globs; an empty list matches all.

    Files that runs made are inputs only with `derived`. `metadata` names the metadata fields of the mission that the
    action reads; with `checks`, it reads the `checks.yaml` of the project, and all metadata, by which its profiles are
    chosen. With `reference`, it reads the reference trajectory that the metadata or the `checks.yaml` name, and nothing
    else of them. Results depend on the values of what is declared: if one changes, they are outdated.
    """

    paths: Globs = []
    topics: Globs = []
    message_types: Globs = []
    derived: bool = False
    metadata: Annotated[list[MetadataKey], Field(max_length=50)] = []
    checks: bool = False
    reference: bool = False


def _size(value: object) -> object:
    return _integer(read_size(value)) if isinstance(value, str) else value


def _seconds(value: object) -> object:
    return _integer(read_duration(value) / 10**9) if isinstance(value, str) and not value.isdigit() else value


def _integer(amount: Fraction) -> int:
    if amount.denominator != 1:
        raise ValueError("is not a whole number of bytes or seconds")
    return int(amount)


class Resources(Request):
    """The limits of a run, which its runner reserves. In manifests also as `memory: 4GB`, `time: 30m`.

    `disk_bytes` is for `/out` and `/tmp` together.
    """

    model_config = ConfigDict(validate_by_name=True)

    cores: Annotated[float, Field(gt=0, le=1024)] = 1
    memory_bytes: Annotated[
        int,
        BeforeValidator(_size),
        Field(ge=16 * 2**20, le=2**46, validation_alias=AliasChoices("memory_bytes", "memory")),
    ] = 2 * 10**9
    disk_bytes: Annotated[
        int, BeforeValidator(_size), Field(ge=2**20, le=2**50, validation_alias=AliasChoices("disk_bytes", "disk"))
    ] = 10 * 10**9
    gpus: Annotated[int, Field(ge=0, le=64)] = 0
    time_s: Annotated[
        int, BeforeValidator(_seconds), Field(ge=1, le=30 * 86_400, validation_alias=AliasChoices("time_s", "time"))
    ] = 3600
    labels: Annotated[list[Label], Field(max_length=20)] = []


OptionName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]{0,63}$")]
OptionValue = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.,:;/=@%+*&|()\[\]-]{0,200}$")]
Constraint = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.,&|*()\[\]-]{1,200}$")]


class ClusterRequest(Request):
    """What a run needs of a cluster beyond its resources; a runner of one machine ignores it.

    `constraint` names features of nodes, such as `a100|h100`. `exclusive`: nothing else runs on its node. `options` are
    further options of the cluster's submission, by their names without dashes, of those that its runner allows.
    """

    constraint: Constraint | None = None
    exclusive: bool = False
    options: Annotated[dict[OptionName, OptionValue], Field(max_length=20)] = {}


class Better(str, enum.Enum):
    """Which values of a metric are better; `none`: neither, as of a count."""

    lower = "lower"  # type: ignore[assignment]  # hides a method of str, which nobody calls
    higher = "higher"
    none = "none"


class DeclaredMetric(Request):
    """A metric that an action reports. `unit` is that of values which are reported without one."""

    name: Code
    unit: Annotated[str, AfterValidator(check_text), Field(max_length=32)] | None = None
    better: Better = Better.none
    description: Annotated[str, AfterValidator(check_text), Field(max_length=1000)] = ""


class ParametersWrong(ValueError):
    """Invalid parameter values of an action: a sentence by the name of each parameter."""

    def __init__(self, problems: Mapping[str, str]) -> None:
        super().__init__("; ".join(problems.values()))
        self.problems = problems


def _python_versions(text: str) -> str:
    from kleinkram.contract import locks  # slow to import

    return locks.check_python_versions(text)


def _check_lock(lock: str, dependencies: list[str]) -> None:
    from kleinkram.contract import locks  # slow to import

    try:
        requirements = [locks.parse_requirement(dependency) for dependency in dependencies]
        locks.check_lock(locks.parse_lock(lock), requirements)
    except ValueError as error:
        raise ValueError(f"the lock {error}") from None


class ActionDefinition(Request):
    """One version of an action: either an `image` with its `command`, or a `script` on the default image.

    `command` is an argument list; empty: the image's own command. A script is started with Python, and its
    `dependencies` (PEP 508) are installed for it in the versions of its `lock` (pip requirements with hashes), which
    the server makes where it is null. Without a lock, they must be installed in the image. `requires_python` (`>=3.11`)
    is the Python that the script needs.
    `right` is the right on the mission that launching requires, and the right of the run's token.
    `metrics` describes metrics for tables; an action may report others, too.
    `library` is set by the server where it added a shipped action; it is ignored in what people publish or run.
    """

    name: Name
    description: Annotated[str, AfterValidator(check_text), Field(max_length=10_000)] = ""
    image: ImageName | None = None
    command: Annotated[list[Argument], Field(max_length=1000)] = []
    script: Annotated[str, AfterValidator(check_text), Field(max_length=MAX_SCRIPT_CHARACTERS)] | None = None
    dependencies: Annotated[list[Term], Field(max_length=200)] = []
    requires_python: Annotated[str, AfterValidator(_python_versions), Field(max_length=100)] | None = None
    lock: Annotated[str, AfterValidator(check_text), Field(max_length=MAX_LOCK_CHARACTERS)] | None = None
    parameters: Annotated[list[Parameter], Field(max_length=MAX_PARAMETERS)] = []
    metrics: Annotated[list[DeclaredMetric], Field(max_length=MAX_DECLARED_METRICS)] = []
    inputs: Inputs = Inputs()
    resources: Resources = Resources()
    cluster: ClusterRequest = ClusterRequest()
    network: Network = Network.none
    right: Right = Right.read
    library: LibraryVersion | None = None

    @model_validator(mode="after")
    def _can_be_run(self) -> Self:
        if self.image is None and self.script is None:
            raise ValueError("an action requires an 'image' or a 'script'")
        if self.script is not None and self.command:
            raise ValueError("a script has no 'command'")
        if self.script is None and self.dependencies:
            raise ValueError("only a script has 'dependencies'; an image contains its own")
        if self.lock is not None:
            _check_lock(self.lock, self.dependencies)
        for what, declared in (("parameter", self.parameters), ("metric", self.metrics)):
            names = [entry.name for entry in declared]
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"the {what} {twice[0]!r} is declared twice")
        return self

    def fill_in(self, values_by_name: ParameterValues) -> ParameterValues:
        """Return the values of all parameters: those passed, checked, and the defaults of the others.

        Raises ParametersWrong.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        choices = ", ".join(known) or "none at all"
        unknown = sorted(set(values_by_name) - set(known))
        problems = {name: f"{self.name} has no parameter {name!r}; it has {choices}" for name in unknown}
        values: ParameterValues = {}
        for name, parameter in known.items():
            value = values_by_name.get(name, parameter.default)
            try:
                if value is not None:
                    values[name] = parameter.check(value)
                else:
                    problems[name] = f"{self.name} requires its parameter {name!r}"
            except ValueError as error:
                problems[name] = str(error)
        if problems:
            raise ParametersWrong(problems)
        return values


def _without_library(definition: ActionDefinition) -> ActionDefinition:
    return definition if definition.library is None else definition.model_copy(update={"library": None})


OwnDefinition = Annotated[ActionDefinition, AfterValidator(_without_library)]
"""The definition of an action by a person, not by the library, whatever it says."""


class ActionCreate(Request):
    """An action to publish: in a project, or without one for the whole lab."""

    project_id: uuid.UUID | None = None
    definition: OwnDefinition


class VersionCreate(Request):
    """A further version of an action; the name is unchanged."""

    definition: OwnDefinition


class ActionUpdate(Request):
    """A change of an action. An archived action is not listed and starts no runs; its runs stay."""

    archived: bool


class ActionVersionRead(Response):
    """One version of an action, which never changes.

    `image_digest` is what the image's name was first resolved to (`sha256:…`), from then on used by every run; null
    before, and for a script on the default image. `packages` are the versions in its lock, such as
    `evo==1.38.1`; lists leave the lock itself out, since it is large.
    """

    id: uuid.UUID
    number: Annotated[int, Field(ge=1)]
    definition: ActionDefinition
    packages: list[str] = []
    image_digest: str | None
    created_at: datetime.datetime
    created_by: PersonRef


def _etag(fields: dict[str, Any]) -> str:
    return etag_of("action", fields["id"], fields["latest"].number, fields["archived"])


class ActionRead(Response):
    """An action with its latest version. `project` is null for the whole lab; `may_change`: the caller may change it.

    `etag` covers the latest version and `archived`: a change or a further version with an outdated one is refused.
    """

    id: uuid.UUID
    name: str
    description: str
    project: ProjectRef | None
    latest: ActionVersionRead
    archived: bool
    created_at: datetime.datetime
    created_by: PersonRef
    may_change: bool
    etag: ETag = Field(default_factory=_etag)


class ActionFilter(Request):
    """A filter for actions. `name` may be a glob; `project_id`: those of a project and those of the whole lab."""

    name: Term | None = None
    project_id: uuid.UUID | None = None
    archived: bool | None = False
