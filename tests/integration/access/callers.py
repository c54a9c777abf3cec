"""How the matrix calls each operation."""

from tests.integration.access.call import Caller
from tests.integration.access.callers_of_objects import OF_THINGS
from tests.integration.access.callers_of_people import OF_PEOPLE, PUBLIC_OPERATIONS
from tests.integration.access.callers_of_runs import OF_RUNS

CALLERS: dict[str, tuple[Caller, ...]] = {**OF_THINGS, **OF_RUNS, **OF_PEOPLE}

__all__ = ["CALLERS", "PUBLIC_OPERATIONS"]
