"""How a side is run as a process of its own: its name and arguments on the command line, its account as JSON."""

import json
import resource
import sys
from collections.abc import Callable, Iterable

Facts = dict[str, float]
"""What a side says of itself: `seconds`, which it measured itself, and whatever else it knows."""


def main(sides: Iterable[Callable[..., Facts]]) -> None:
    """Run the side that the command line names, and print its account."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    account = {side.__name__: side for side in sides}[sys.argv[1]](*sys.argv[2:])
    # What importing cost is no part of the work.
    account["import_cpu_s"] = usage.ru_utime + usage.ru_stime
    sys.stdout.write(json.dumps(account))
