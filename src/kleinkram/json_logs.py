"""Log lines of long-running processes: one JSON object each. Never a secret or a signed URL.

A line has the role of its process and its host, and the ids of what it belongs to: the fields that `log_fields` binds
for a request, a job or a run, and the trace.
"""

import contextvars
import datetime
import json
import logging
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from kleinkram import traces

_bound: contextvars.ContextVar[Mapping[str, object]] = contextvars.ContextVar("log fields", default={})  # noqa: B039  never changed


class JsonLines(logging.Formatter):
    """Formats a record, its fields and its exception as one line. `role`: what the process does, as in "worker"."""

    def __init__(self, role: str) -> None:
        super().__init__()
        self._process = {"role": role, "host": socket.gethostname()}

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        at = datetime.datetime.fromtimestamp(record.created, datetime.timezone.utc)
        line: dict[str, object] = {
            "at": at.isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            # uvicorn's logger of ordinary lines is called `uvicorn.error`.
            "logger": "uvicorn" if record.name == "uvicorn.error" else record.name,
            "message": record.getMessage(),
            **self._process,
            **bound_fields(),
            **getattr(record, "fields", {}),
        }
        if (trace_id := traces.trace_id()) is not None:
            line["trace_id"] = trace_id
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return _escape_controls(json.dumps(line, ensure_ascii=False, default=str))


@contextmanager
def log_fields(**fields: object) -> Iterator[None]:
    """Add fields to the lines that are logged in a block; those that are None are left out."""
    token = _bound.set({**_bound.get(), **{name: value for name, value in fields.items() if value is not None}})
    try:
        yield
    finally:
        _bound.reset(token)


def bound_fields() -> Mapping[str, object]:
    """Return the fields that lines have here."""
    return _bound.get()


def _escape_controls(text: str) -> str:
    """Escape control characters: clients choose the paths in requests."""
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else json.dumps(letter)[1:-1] for letter in text)
