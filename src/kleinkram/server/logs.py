"""Log lines: one JSON object each, with the request id if there is one. Never a secret or a signed URL."""

import datetime
import json
import logging
import sys
import threading
import types
from typing import Literal


class JsonLines(logging.Formatter):
    """Formats a record, its fields and its exception as one line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        at = datetime.datetime.fromtimestamp(record.created, datetime.timezone.utc)
        line: dict[str, object] = {
            "at": at.isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            # uvicorn's logger of ordinary lines is called `uvicorn.error`.
            "logger": "uvicorn" if record.name == "uvicorn.error" else record.name,
            "message": record.getMessage(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return _escape_controls(json.dumps(line, ensure_ascii=False, default=str))


def _escape_controls(text: str) -> str:
    """Escape control characters: clients choose the paths in requests."""
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else json.dumps(letter)[1:-1] for letter in text)


def set_up_logs(log_format: Literal["json", "text"]) -> None:
    """Log to stderr, with only warnings of libraries that log URLs."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        JsonLines() if log_format == "json" else logging.Formatter("%(asctime)s %(levelname)s %(name)s %(message)s")
    )
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.captureWarnings(True)
    sys.excepthook = _log_crash
    threading.excepthook = lambda ended: _log_crash(ended.exc_type, ended.exc_value, ended.exc_traceback)
    quiet_libraries()


def _log_crash(kind: type[BaseException], error: BaseException | None, traceback: types.TracebackType | None) -> None:
    """Log the error that ends the process or a thread."""
    if error is not None and not isinstance(error, KeyboardInterrupt):
        logging.getLogger("kleinkram").critical(
            f"ended by an error: {kind.__name__}: {error}", exc_info=(kind, error, traceback)
        )


def quiet_libraries() -> None:
    """Log only warnings of libraries that log URLs."""
    for noisy in ("aiohttp", "uvicorn.access", "alembic", "procrastinate", "httpx"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
