"""How each operation is called in the matrix: the one place where that is said."""

from tests.integration.access.callers_of_people import DOORS, OF_PEOPLE
from tests.integration.access.callers_of_runs import OF_RUNS
from tests.integration.access.callers_of_things import OF_THINGS
from tests.integration.access.calling import Caller

CALLERS: dict[str, tuple[Caller, ...]] = {**OF_THINGS, **OF_RUNS, **OF_PEOPLE}

__all__ = ["CALLERS", "DOORS"]
