"""Classes of isolation: what separates a run from its machine and from other runs."""

import enum


class Isolation(str, enum.Enum):
    """What separates a run from its machine and from other runs; the strongest class first.

    A project has the weakest class that its runs may have, a runner the class of its executor.
    """

    container = "container"
    namespaces = "namespaces"
    none = "none"

    def is_at_least(self, required: "Isolation") -> bool:
        """Whether this class is as strong as another, or stronger."""
        classes = [*Isolation]
        return classes.index(self) <= classes.index(required)


def strongest(*classes: Isolation) -> Isolation:
    """Return the strongest of some classes."""
    return min(classes, key=[*Isolation].index)
