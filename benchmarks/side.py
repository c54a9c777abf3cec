"""A side runs as its own process: name and arguments on the command line, its measurement as JSON."""

import json
import resource
import sys
from collections.abc import Callable, Iterable

Facts = dict[str, float]
"""The measurement of a side: `seconds`, measured by itself, and further values."""


def main(sides: Iterable[Callable[..., Facts]]) -> None:
    """Run the side that the command line names, and print its measurement."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    account = {side.__name__: side for side in sides}[sys.argv[1]](*sys.argv[2:])
    # CPU time of imports, which is subtracted.
    account["import_cpu_s"] = usage.ru_utime + usage.ru_stime
    sys.stdout.write(json.dumps(account))
