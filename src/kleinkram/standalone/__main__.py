"""`python -m kleinkram.standalone up|runner OPTIONS`: supervisor or runner of `klein up`, without the CLI's imports.

OPTIONS is the JSON of `UpOptions` or `RunnerServiceOptions`. `klein up` becomes the first process. The supervisor
starts the second, which creates the runner's token where it has none, and then becomes the runner.
"""

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

from kleinkram.failures import code_of, failure_line
from kleinkram.standalone.address import Listening
from kleinkram.standalone.data_dir import write_private
from kleinkram.standalone.errors import StandaloneError
from kleinkram.standalone.http_client import request_with_token
from kleinkram.standalone.services import RunnerServiceOptions, UpOptions
from kleinkram.standalone.supervisor import run

_TIMEOUT_S = 30.0


def arguments(options: UpOptions) -> list[str]:
    """Return the command line that runs the supervisor with these options."""
    return [sys.executable, "-m", "kleinkram.standalone", "up", json.dumps(asdict(options), default=str)]


def main() -> None:
    """Run until the end is requested; a failure is one sentence on stderr and exit code 1."""
    values = json.loads(sys.argv[2])
    if sys.argv[1] == "runner":
        _become_runner(RunnerServiceOptions(**values))
    listening = values.pop("listening")
    for name in ("tls_cert", "tls_key"):
        listening[name] = Path(listening[name]) if listening[name] else None
    values["data_dir"], values["server"] = Path(values["data_dir"]), tuple(values["server"])
    options = UpOptions(listening=Listening(**listening), **values)
    try:
        run(options)
    except StandaloneError as error:
        sys.exit(failure_line(str(error), code=code_of(error), exit_code=1, as_json=options.as_json))


def _become_runner(options: RunnerServiceOptions) -> None:
    """Replace the runner's token if the server does not accept it, then replace this process by the runner."""
    certificate = Path(options.certificate) if options.certificate else None
    token_file = Path(str(options.runner["token_file"]))

    def is_accepted() -> bool:
        token = token_file.read_text().strip()
        url = f"{options.api_url}/api/v1/service"
        return request_with_token("GET", url, token, certificate=certificate, timeout_s=_TIMEOUT_S).status != 401

    if not token_file.exists() or not is_accepted():
        values = {"name": "runner of klein up", "kind": "runner"}
        id_file = Path(str(options.runner["data_dir"])) / "id"
        if id_file.exists():  # the new token replaces this runner's others
            values["runner_id"] = id_file.read_text().strip()
        owner = Path(options.owner_token_file).read_text().strip()
        response = request_with_token(
            "POST",
            f"{options.api_url}/api/v1/tokens",
            owner,
            values=values,
            certificate=certificate,
            timeout_s=_TIMEOUT_S,
        )
        if response.status >= 300:
            sys.exit(f"Error: the API refused a token for the runner: {response.body.decode(errors='replace')[:500]}")
        write_private(token_file, json.loads(response.body)["secret"] + "\n")
    command = [sys.executable, "-m", "kleinkram.runner", json.dumps(options.runner)]
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)


if __name__ == "__main__":
    main()
