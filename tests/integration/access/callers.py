"""How the matrix calls each operation."""

from tests.integration.access.call import Caller
from tests.integration.access.callers_of_objects import OBJECT_OPERATIONS
from tests.integration.access.callers_of_people import PEOPLE_OPERATIONS, PUBLIC_OPERATIONS
from tests.integration.access.callers_of_runs import RUN_OPERATIONS

CALLERS: dict[str, tuple[Caller, ...]] = {**OBJECT_OPERATIONS, **RUN_OPERATIONS, **PEOPLE_OPERATIONS}

__all__ = ["CALLERS", "PUBLIC_OPERATIONS"]
