"""The library: actions that are shipped with Kleinkram, which a project or the whole lab can add."""

import enum
import uuid

from kleinkram.contract.access import Right
from kleinkram.contract.actions import DeclaredMetric, Inputs, Network, Parameter, Resources
from kleinkram.contract.base import Request, Response

LIBRARY_PREFIX = "kleinkram/"


class LibraryState(str, enum.Enum):
    """Whether a project, or the whole lab, has an action of the library.

    `available`: it has none of that name. `added`: it has what is shipped. `outdated`: adding it again publishes the
    next version. `name_taken`: its latest version of that name is not from the library.
    """

    available = "available"
    added = "added"
    outdated = "outdated"
    name_taken = "name_taken"


class LibraryFilter(Request):
    """Whose actions the states of the library are about: a project's, or without one the whole lab's."""

    project_id: uuid.UUID | None = None


class LibraryAdd(Request):
    """Where to add an action of the library: in a project, or without one for the whole lab."""

    project_id: uuid.UUID | None = None


class LibraryActionRead(Response):
    """An action of the library. `name` is that of its library, `kleinkram/preview`; `version` that of Kleinkram.

    `action_id` and `action_version` are the action of that name which the project or the lab has, in its latest
    version.
    """

    name: str
    version: str
    description: str
    dependencies: list[str]
    requires_python: str | None
    parameters: list[Parameter]
    metrics: list[DeclaredMetric]
    inputs: Inputs
    resources: Resources
    network: Network
    right: Right
    state: LibraryState
    action_id: uuid.UUID | None
    action_version: int | None


class LibraryRead(Response):
    """All actions of the library, by name."""

    items: list[LibraryActionRead]
