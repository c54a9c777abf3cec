"""`python -m kleinkram.standalone OPTIONS`: the supervisor as a process of its own, without the CLI's imports.

OPTIONS is the JSON that `arguments` writes. `klein up` turns itself into this process.
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path

from kleinkram.failures import code_of, failure_line
from kleinkram.standalone.address import Listening
from kleinkram.standalone.errors import StandaloneError
from kleinkram.standalone.plan import UpOptions
from kleinkram.standalone.supervisor import run


def arguments(options: UpOptions) -> list[str]:
    """The command line that runs the supervisor with these options."""
    return [sys.executable, "-m", "kleinkram.standalone", json.dumps(asdict(options), default=str)]


def main() -> None:
    """Run until asked to stop; a failure is one sentence on stderr and exit code 1."""
    options = _options(sys.argv[1])
    try:
        run(options)
    except StandaloneError as error:
        sys.exit(failure_line(str(error), code=code_of(error), exit_code=1, as_json=options.as_json))


def _options(text: str) -> UpOptions:
    given = json.loads(text)
    listening = given.pop("listening")
    for name in ("tls_cert", "tls_key"):
        listening[name] = Path(listening[name]) if listening[name] else None
    given["data_dir"], given["server"] = Path(given["data_dir"]), tuple(given["server"])
    return UpOptions(listening=Listening(**listening), **given)


if __name__ == "__main__":
    main()
