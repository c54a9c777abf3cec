"""A server that returns scripted answers and records the requests."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel

from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.problems import to_problem
from tests.http_server import QuietHandler, serving

# With a status of its own, it is what something else says that stands before the server.
Answer = BaseModel | KleinkramError | bytes | tuple[int, bytes] | None


@dataclass(frozen=True)
class RecordedRequest:
    """One request."""

    method: str
    path: str
    authorization: str | None
    body: Any


@dataclass
class Scripted:
    """The server: its address, what it has yet to say, what it was requests."""

    url: str = ""
    answers: list[Answer] = field(default_factory=list)
    requests: list[RecordedRequest] = field(default_factory=list)


@contextmanager
def scripted(*answers: Answer, by_path: Mapping[str, BaseModel] | None = None) -> Iterator[Scripted]:
    """Run the server. A model is answered with 200, an error with its status, None with a connection that breaks.

    What ends as `by_path` says is answered so, however often it is requested.
    """
    script = Scripted(answers=[*answers])

    class Speaker(QuietHandler):
        timeout = 5

        def _respond(self) -> None:
            body = self.body()
            known = self.headers.get("Authorization")
            script.requests.append(RecordedRequest(self.command, self.path, known, json.loads(body) if body else None))
            place = self.path.partition("?")[0]
            always = [answer for end, answer in (by_path or {}).items() if place.endswith(end)]
            status, answer = _answer_bytes(always[0] if always else script.answers.pop(0))
            if answer is None:
                self.close_connection = True
                return
            self.send(status, answer)

        do_GET = do_POST = do_DELETE = _respond

    with serving(Speaker) as port:
        script.url = f"http://127.0.0.1:{port}"
        yield script


def _answer_bytes(answer: Answer) -> tuple[int, bytes | None]:
    if isinstance(answer, KleinkramError):
        return answer.status, to_problem(answer, "r").model_dump_json().encode()
    if isinstance(answer, BaseModel):
        return 200, answer.model_dump_json().encode()
    if isinstance(answer, tuple):
        return answer
    return 200 if answer else 204, answer
