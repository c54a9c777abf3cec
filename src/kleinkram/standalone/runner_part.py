"""`python -m kleinkram.standalone.runner_part OPTIONS`: sees that the runner of this instance has a token, then is it.

OPTIONS is the JSON of `RunnerPart`. The token is made by the owner's, kept in a file of mode 0600, and made anew where
the server does not know it any more.
"""

import http.client
import json
import os
import ssl
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import urlsplit

from kleinkram.standalone.data_dir import write_private
from kleinkram.standalone.trust import just_this

_TIMEOUT_S = 30.0
_NAME = "runner of klein up"


@dataclass(frozen=True)
class RunnerPart:
    """Where the API answers here (with which certificate, if any), where the tokens are, and the runner's arguments."""

    api_url: str
    certificate: str | None
    owner_token_file: str
    runner: dict[str, object]

    def command(self) -> list[str]:
        """Return the command line."""
        return [sys.executable, "-m", "kleinkram.standalone.runner_part", json.dumps(asdict(self))]


def main() -> None:
    """See to the token and become the runner."""
    part = RunnerPart(**json.loads(sys.argv[1]))
    token_file = Path(str(part.runner["token_file"]))
    if not token_file.exists() or not _is_known(part, token_file.read_text().strip()):
        write_private(token_file, _make_token(part) + "\n")
    command = [sys.executable, "-m", "kleinkram.runner", json.dumps(part.runner)]
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)


def _is_known(part: RunnerPart, token: str) -> bool:
    status, _ = _ask(part, "GET", "/api/v1/service", token)
    return status != http.client.UNAUTHORIZED


def _make_token(part: RunnerPart) -> str:
    owner = Path(part.owner_token_file).read_text().strip()
    wanted = {"name": _NAME, "kind": "runner"}
    identity = Path(str(part.runner["data_dir"])) / "id"
    if identity.exists():  # another token of this runner may still be good; one that names the runner replaces it
        wanted["runner_id"] = identity.read_text().strip()
    status, answer = _ask(part, "POST", "/api/v1/tokens", owner, wanted)
    if status >= http.client.MULTIPLE_CHOICES:
        sys.exit(f"Error: the API gives no token for a runner: {answer.decode(errors='replace')[:500]}")
    return str(json.loads(answer)["secret"])


def _ask(part: RunnerPart, method: str, path: str, token: str, said: dict[str, str] | None = None) -> tuple[int, bytes]:
    host = urlsplit(part.api_url).netloc
    connection: http.client.HTTPConnection
    if part.certificate is None:
        connection = http.client.HTTPConnection(host, timeout=_TIMEOUT_S)
    else:
        context: ssl.SSLContext = just_this(Path(part.certificate))
        connection = http.client.HTTPSConnection(host, timeout=_TIMEOUT_S, context=context)
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    try:
        connection.request(method, path, json.dumps(said) if said else None, headers)
        answer = connection.getresponse()
        return answer.status, answer.read(65_536)
    finally:
        connection.close()


if __name__ == "__main__":
    main()
